"""Simulated arms that give way to a push: servos become springs and dampers of joints, or motors for those of a TCP."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from rcs._core import Springs
from rcs.kinematics.damping import damped

if TYPE_CHECKING:  # a scene has its arms give way
    from rcs.sim.scene import RobotPlacement


def give_way(spec: mujoco.MjSpec, robot: RobotPlacement) -> None:
    """Have the servos of a robot in a scene give way, if it has a compliance.

    Controllers that lead an arm by torques measure them behind the gears, and make up for friction; so there is none.
    """
    compliance = robot.compliance
    if compliance is None:
        return
    stiffness, damping = damped(compliance, robot.arm, robot.end_effector).gains
    for i, (joint_name, actuator_name) in enumerate(zip(robot.arm.joints, robot.arm.actuators, strict=True)):
        joint, servo = spec.joint(robot.prefix + joint_name), spec.actuator(robot.prefix + actuator_name)
        joint.frictionloss, joint.damping = 0.0, np.zeros_like(joint.damping)
        if compliance.is_of_tcp:
            servo.set_to_motor()
        else:
            servo.set_to_position(kp=stiffness[i], kv=damping[i])


def springs_of(robot: RobotPlacement, tcp_site: int, base_body: int) -> Springs | None:
    """Return the springs of a robot's motion; None for stiff servos.

    Args:
        robot: The robot.
        tcp_site: Id of its TCP.
        base_body: Id of its base.
    """
    if robot.compliance is None:
        return None
    if not robot.compliance.is_of_tcp:
        return Springs()
    return Springs(*damped(robot.compliance, robot.arm, robot.end_effector).gains, tcp_site, base_body)
