"""The figures of the Robotiq 2F-85."""

from __future__ import annotations

from math import sqrt
from typing import Final

from rcs.robots.description import GripperDescription, MenagerieBody, MenagerieVisuals, Mount

_HALF = sqrt(0.5)

# Angle at which the pads meet [rad]: 0.0306011 m + 0.05749 m * cos(angle + 0.8579) = 0.0257 m, the driver's pivot, the
# length and first angle of driver and coupler, and the distance of the pad's face from the finger's pivot.
_CLOSED: Final = 0.798156


def _meshes() -> MenagerieVisuals:
    """Return where the collection's meshes go: several to a body that is fused here, and its right ones to our left."""
    bodies = [
        MenagerieBody(
            body="base",
            source="base_mount",
            source_in_body=Mount(translation=(0.0, 0.0, 0.007), quaternion=(0.0, 0.0, _HALF, _HALF)),
        ),
        MenagerieBody(body="base", source="base", source_in_body=Mount(translation=(0.0, 0.0, 0.0108))),
    ]
    for side, other in (("left", "right"), ("right", "left")):
        for body, source, translation in (
            ("driver", "driver", (0.0, 0.0, 0.0)),
            ("driver", "coupler", (0.0, 0.0315, -0.0041)),
            ("knuckle", "spring_link", (0.0, 0.0, 0.0)),
            ("finger", "follower", (0.0, 0.0, 0.0)),
            ("finger", "pad", (0.0, -0.0189, 0.01352)),
            ("finger", "silicone_pad", (0.0, -0.0189, 0.01352)),
        ):
            mount = Mount(translation=translation)
            bodies.append(MenagerieBody(body=f"{side}_{body}", source=f"{other}_{source}", source_in_body=mount))
    return MenagerieVisuals(model="robotiq_2f85", entry="2f85", bodies=tuple(bodies))


ROBOTIQ_2F85: Final = GripperDescription(
    name="robotiq_2f85",
    label="Robotiq 2F-85",
    module=__name__,
    mjcf_file="robotiq_2f85.xml",
    base_body="base",
    # The coupling sits flat on the flange. That the fingers open along the flange's y axis is our choice.
    mount_in_flange=Mount(),
    tcp_site="tcp",
    # Centre of the closed pads. On a circular way they are 14 mm nearer to the flange when open, 1 mm when 32 mm apart.
    tcp_in_base=Mount(translation=(0.0, 0.0, 0.1553)),
    # All six turn by the same angle; a state with an opening needs them all.
    joints=(
        "left_driver_joint",
        "left_finger_joint",
        "left_knuckle_joint",
        "right_driver_joint",
        "right_finger_joint",
        "right_knuckle_joint",
    ),
    joint_closed=(_CLOSED,) * 6,
    joint_open=(0.0,) * 6,
    actuator="fingers",
    # Normalised opening, as in observations and actions: 0 closed, 1 open. It is linear in the angle, as the real
    # gripper's position is in its motor's; the width is at most 2.9 mm above a straight line.
    ctrl_closed=0.0,
    ctrl_open=1.0,
    pad_geoms=(("left_pad",), ("right_pad",)),
    # Vendor's data sheet: stroke 85 mm, grip force 20 to 235 N, closing speed 20 to 150 mm/s.
    max_width=0.085,
    max_force=235.0,
    # Our choice, at a width of 32 mm; from 40 N closed to 52 N open, since the torque is what the drive limits.
    grasp_force=40.0,
    # The device's largest speed, half of it at each finger. The pads reach it where they meet: they are on circles.
    closing_speed=0.075,
    sources=(
        "mujoco_menagerie robotiq_2f85 (BSD-2-Clause): pivots, masses, inertias, pads, armature of the drive",
        "Robotiq 2F-85 data sheet: stroke, forces, speeds",
        "mujoco_menagerie ufactory_xarm7 hand (BSD-3-Clause): friction and stiffness of the pads",
    ),
    menagerie=_meshes(),
)
"""The 2F-85 with its coupling."""
