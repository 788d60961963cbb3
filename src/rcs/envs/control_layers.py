"""The layers that a setup asks for on top of a robot's ports."""

from __future__ import annotations

import numpy as np

from rcs.envs.layers import (
    BinaryGripper,
    CartesianControl,
    GraspHand,
    Layer,
    LimitPose,
    LimitStep,
    NativeTwist,
    Relative,
    TwistControl,
    XyzrpyControl,
)
from rcs.envs.setup import Setup
from rcs.envs.spaces import TQUAT, TWIST, XYZRPY
from rcs.kinematics import kinematics_of
from rcs.robots.description import ArmDescription
from rcs.sim.scene import RobotPlacement

GRASP = "power"
"""The grasp of a hand that is used like a gripper."""

RETURN_SPEED = 0.1
"""Largest speed of a joint that comes back into its range from where it was found [rad/s]: slow enough to step in."""


def layers_of(setup: Setup, robot: RobotPlacement, *, threads: int = 1, is_native: bool = False) -> list[Layer]:
    """Return the layers that a setup asks for, from the lowest to the highest.

    Args:
        setup: The setup.
        robot: The robot.
        threads: Threads that solve for the joints of many copies.
        is_native: Whether the arm's controller takes poses or twists, so that nothing is solved for.
    """
    # A synchronous step lasts as long as it needs, so its target is not bounded; a device's port bounds the way there.
    control = setup.control
    is_bounded = setup.stepping != "sync" and not is_native
    layers: list[Layer] = [limit_step(robot.arm, setup.frequency)] if is_bounded else []
    if is_native:
        layers += [NativeTwist(setup.frequency)] if control == TWIST else [limit_pose(robot.arm, setup.frequency)]
    elif control in (TQUAT, XYZRPY):
        kinematics = kinematics_of(robot.arm, robot.end_effector)
        bound = None if setup.stepping == "sync" else np.array(robot.arm.velocity_limit) / setup.frequency
        layers.append(CartesianControl(kinematics, preferred=robot.arm.home, max_step=bound, threads=threads))
    elif control == TWIST:
        layers.append(
            TwistControl(
                kinematics_of(robot.arm, robot.end_effector),
                frequency=setup.frequency,
                joint_speed=robot.arm.velocity_limit,
                translation_speed=robot.arm.tcp_speed,
                rotation_speed=robot.arm.tcp_turn_speed,
                preferred=robot.arm.home,
                threads=threads,
            )
        )
    if control == TWIST:
        pass  # a velocity has no reference
    elif setup.relative != "absolute":
        layers.append(
            Relative(
                control,
                frequency=setup.frequency,
                to=setup.relative,
                joint_speed=robot.arm.velocity_limit,
                translation_speed=robot.arm.tcp_speed,
                rotation_speed=robot.arm.tcp_turn_speed,
            )
        )
    elif control == XYZRPY:
        layers.append(XyzrpyControl())
    if robot.gripper is not None and setup.binary_gripper:
        layers.append(BinaryGripper())
    if robot.hand is not None and setup.binary_gripper:
        layers.append(GraspHand(robot.hand.open_pose, robot.hand.grasps[GRASP]))
    return layers


def limit_step(arm: ArmDescription, frequency: float) -> LimitStep:
    """Return what bounds targets to what an arm can do in one period of a control frequency [Hz]."""
    return LimitStep(
        np.array(arm.velocity_limit) / frequency,
        np.array(arm.motion_limits.lead(1.0 / frequency)),
        lower=arm.joint_lower,
        upper=arm.joint_upper,
        max_return=RETURN_SPEED / frequency,
    )


def limit_pose(arm: ArmDescription, frequency: float) -> LimitPose:
    """Return what bounds targets of the TCP to what relative actions ask for at a control frequency [Hz]."""
    along_all_axes = np.sqrt(3.0) * arm.tcp_speed
    return LimitPose(along_all_axes, arm.tcp_turn_speed, frequency=frequency)
