"""The layers that a setup asks for on top of a robot's ports."""

from __future__ import annotations

import numpy as np

from rcs.envs.layers import (
    BinaryGripper,
    CartesianControl,
    GraspHand,
    Layer,
    LimitStep,
    Relative,
    TwistControl,
    XyzrpyControl,
)
from rcs.envs.setup import Setup
from rcs.envs.spaces import TQUAT, TWIST, XYZRPY
from rcs.kinematics import kinematics_of
from rcs.sim.scene import RobotPlacement

GRASP = "power"
"""The grasp of a hand that is used like a gripper."""


def layers_of(setup: Setup, robot: RobotPlacement, *, threads: int = 1) -> list[Layer]:
    """Return the layers that a setup asks for, from the lowest to the highest.

    Args:
        setup: The setup.
        robot: The robot.
        threads: Threads that solve for the joints of many copies.
    """
    # What an arm can do in one period; a synchronous step lasts as long as it needs, so there the range is the bound.
    step = np.array(robot.arm.velocity_limit) / setup.frequency
    control = setup.control
    layers: list[Layer] = []
    is_bounded = setup.stepping != "sync"
    if is_bounded:
        layers.append(LimitStep(step, np.array(robot.arm.motion_limits.lead(1.0 / setup.frequency))))
    if control in (TQUAT, XYZRPY):
        kinematics = kinematics_of(robot.arm, robot.end_effector)
        bound = step if is_bounded else None
        layers.append(CartesianControl(kinematics, preferred=robot.arm.home, max_step=bound, threads=threads))
    if control == TWIST:
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
