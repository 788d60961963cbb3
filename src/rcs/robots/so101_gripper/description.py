"""The figures of the SO101 gripper."""

from __future__ import annotations

from math import sqrt
from typing import Final

from rcs.robots.description import GripperDescription, MenagerieVisuals, Mount

_HALF = sqrt(0.5)

SO101_GRIPPER: Final = GripperDescription(
    name="so101_gripper",
    label="SO101 gripper",
    module=__name__,
    mjcf_file="so101_gripper.xml",
    # The published gripper link: its jaws point along -z and open along x.
    base_body="gripper",
    # It is screwed to the servo horn of the arm's last joint, not to a flange.
    arms=("so101",),
    # A half turn about x, from the flange's z to the link's -z.
    mount_in_flange=Mount(quaternion=(1.0, 0.0, 0.0, 0.0)),
    tcp_site="tcp",
    # Origin of the published `gripperframe`, 2 cm before the fixed jaw at the fingertips; that frame itself is a site
    # too. Here z points along the jaws and y from the fixed to the moving one, as with the other grippers.
    tcp_in_base=Mount(translation=(0.012, -0.000218, -0.098127), quaternion=(_HALF, _HALF, 0.0, 0.0)),
    joints=("gripper",),
    # mujoco_menagerie robotstudio_so101: the range of the jaw, -10 to 100 degrees.
    joint_closed=(-0.174533,),
    joint_open=(1.7453292,),
    actuator="gripper",
    # The jaw's angle [rad].
    ctrl_closed=-0.174533,
    ctrl_open=1.7453292,
    # Left is at the TCP's +y, as with the other grippers.
    pad_geoms=(("moving_pad",), ("fixed_pad",)),
    # Between the middles of both pads when open.
    max_width=0.117,
    # LeRobot limits this servo to half of its torque, 1.47 Nm: 18 N at the fingertips.
    max_force=18.0,
    grasp_force=18.0,
    # Of the moving jaw's tip: torque less friction over damping is 2.4 rad/s, 0.85 s from open to closed. The servo at its
    # full torque has 45 rpm without load, 4.7 rad/s.
    closing_speed=0.18,
    sources=(
        "mujoco_menagerie robotstudio_so101 (Apache-2.0): kinematics, limits, inertias, joint dynamics, servo gains",
        "Feetech STS3215 data sheet, 12 V: speed without load 45 rpm",
        "LeRobot so101_follower (Apache-2.0): torque limit of the gripper's servo",
        "mujoco_menagerie ufactory_xarm7 hand (BSD-3-Clause): friction and stiffness of the pads",
    ),
    menagerie=MenagerieVisuals.of(
        "robotstudio_so101", "so101", {"gripper": "gripper", "moving_jaw": "moving_jaw_so101_v1"}
    ),
)
"""The SO101 gripper with one moving jaw."""
