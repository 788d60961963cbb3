"""Changes to a robot's model in a scene: servos that give way to a push, and a body that carries a load."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from rcs._core import Springs
from rcs.kinematics.chain import damped, flange_frame
from rcs.robots.description import ArmDescription

if TYPE_CHECKING:  # a scene has its arms give way
    from rcs.sim.scene import RobotPlacement

LOAD = "load"
"""Name of the body at a robot's flange that carries the compensation of a load (`SimRobot.set_load`)."""
LOAD_MASS = 1e-6
"""Its mass [kg], too small for anything else to notice."""


def give_way(spec: mujoco.MjSpec, robot: RobotPlacement) -> None:
    """Make the servos of a robot with a compliance give way.

    Controllers that lead an arm by torques measure them behind the gears and compensate friction, so joints have none.
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


def add_load(spec: mujoco.MjSpec, arm: ArmDescription) -> None:
    """Add the body of `SimRobot.set_load` to a flange: MuJoCo compensates gravity in proportion to a body's mass."""
    flange = flange_frame(spec, arm)
    flange.parent.add_body(
        name=LOAD,
        mass=LOAD_MASS,
        # Not in the origin: there MuJoCo takes the centre of mass for that of the frame, whatever is written later.
        ipos=[0.0, 0.0, 1e-3],
        inertia=[1e-12] * 3,
        explicitinertial=True,
        gravcomp=1.0,
    ).set_frame(flange)
