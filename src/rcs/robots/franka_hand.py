"""The figures of the Franka Hand."""

from __future__ import annotations

from math import cos, pi, sin
from typing import Final

from rcs.robots.description import GripperDescription, MenagerieVisuals, Mount

FRANKA_HAND: Final = GripperDescription(
    name="franka_hand",
    label="Franka Hand",
    module=__name__,
    mjcf_file="franka_hand.xml",
    base_body="hand",
    # franka_description 1.0.1, end_effectors: rpy 0 0 -pi/4 on the flange, hand_tcp at z = 0.1034 m.
    mount_in_flange=Mount(quaternion=(0.0, 0.0, sin(-pi / 8), cos(-pi / 8))),
    tcp_site="tcp",
    tcp_in_base=Mount(translation=(0.0, 0.0, 0.1034)),
    joints=("finger_joint1", "finger_joint2"),
    # franka_description 1.0.1: each finger slides 0 .. 0.04 m.
    joint_closed=(0.0, 0.0),
    joint_open=(0.04, 0.04),
    actuator="fingers",
    # Normalised opening, as in observations and actions: 0 closed, 1 open.
    ctrl_closed=0.0,
    ctrl_open=1.0,
    pad_geoms=(("left_pad",), ("right_pad",)),
    max_width=0.08,
    # Vendor's data sheet: continuous grasping force 70 N (140 N for a short time).
    max_force=70.0,
    # Our choice: holds 1 kg at a friction coefficient of 0.2 and does not press light objects into the pads.
    grasp_force=30.0,
    # Vendor's product manual: 50 mm/s per finger; the full width takes 0.8 s.
    closing_speed=0.05,
    sources=(
        "franka_description 1.0.1 (Apache-2.0): mount, TCP, finger joints, inertias, finger boxes",
        "mujoco_menagerie franka_emika_panda hand (Apache-2.0): finger armature, coupling of the fingers",
        "Franka Hand product manual 1.2, section 5.1: forces, speed",
        "mujoco_menagerie ufactory_xarm7 hand (BSD-3-Clause): friction and stiffness of the pads",
    ),
    menagerie=MenagerieVisuals.of(
        "franka_emika_panda", "hand", {name: name for name in ("hand", "left_finger", "right_finger")}
    ),
)
"""The Franka Hand with two coupled fingers."""
