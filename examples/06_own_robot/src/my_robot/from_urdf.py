"""The same arm from its URDF, which has links, joints and limits, plus the additions that a simulation needs."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import mujoco

from my_robot import lab
from my_robot.description import MY_ROBOT

SEEN, TOUCHED, SITES = 2, 3, 4
"""Geom groups: visible, colliding, and neither."""
SERVOS: Final = {"large": (0.2, 3000.0, 200.0), "small": (0.05, 800.0, 50.0)}
"""Armature [kg m^2], and stiffness [Nm/rad] and damping [Nm s/rad] of the position controller, by size of joint."""


def complete(spec: mujoco.MjSpec) -> None:
    """Add controllers, the flange and gravity compensation to the model that MuJoCo has read from the URDF.

    Args:
        spec: The model, changed in place. Its joints have the URDF's limits and efforts.
    """
    for body in spec.bodies[1:]:  # the first is the world
        body.gravcomp = 1.0  # as the controller of the real arm does
    for geom in spec.geoms:
        geom.group = SEEN if geom.contype == 0 else TOUCHED
    for joint in spec.joints:
        armature, stiffness, damping = SERVOS["large" if joint.name in ("joint1", "joint2", "joint3") else "small"]
        joint.armature = armature
        joint.actgravcomp = True  # the effort limit includes the weight
        servo = spec.add_actuator(
            name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT, ctrlrange=joint.range
        )
        servo.set_to_position(kp=stiffness, kv=damping)
    spec.body("flange").add_site(name=MY_ROBOT.flange_site, group=SITES)


MY_ROBOT_URDF: Final = replace(
    MY_ROBOT,
    name="my_robot_urdf",
    label="My robot, from its URDF",
    module=__name__,
    mjcf_file="my_robot.urdf",
    complete=complete,
)
"""Our arm, from the URDF."""

LAB: Final = replace(lab.LAB, stands=tuple(replace(stand, arm="my_robot_urdf") for stand in lab.LAB.stands))
"""The lab of our arm with the arm from the URDF."""
