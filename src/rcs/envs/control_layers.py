"""The layers that a setup asks for on top of a robot's ports."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from rcs.devices import CommandKind
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
from rcs.envs.parts import Parts
from rcs.envs.setup import Setup
from rcs.envs.spaces import TQUAT, TWIST, XYZRPY, tquat_space
from rcs.errors import InvalidSetup
from rcs.kinematics import kinematics_of
from rcs.robots.description import ArmDescription
from rcs.sim.scene import RobotPlacement
from rcs.spatial import Pose

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
    speeds: dict[str, Any] = {
        "frequency": setup.frequency,
        "joint_speed": robot.arm.velocity_limit,
        "translation_speed": robot.arm.tcp_speed,
        "rotation_speed": robot.arm.tcp_turn_speed,
    }
    layers: list[Layer] = [limit_step(robot.arm, setup.frequency)] if is_bounded else []
    if is_native and control == TWIST:
        layers.append(NativeTwist(setup.frequency))
    elif is_native:
        along_all_axes = np.sqrt(3.0) * robot.arm.tcp_speed  # as relative actions may ask for
        layers.append(LimitPose(along_all_axes, robot.arm.tcp_turn_speed, frequency=setup.frequency))
    elif control in (TQUAT, XYZRPY):
        kinematics = kinematics_of(robot.arm, robot.end_effector)
        bound = None if setup.stepping == "sync" else np.array(robot.arm.velocity_limit) / setup.frequency
        layers.append(CartesianControl(kinematics, preferred=robot.arm.home, max_step=bound, threads=threads))
    elif control == TWIST:
        kinematics = kinematics_of(robot.arm, robot.end_effector)
        layers.append(TwistControl(kinematics, preferred=robot.arm.home, threads=threads, **speeds))
    if setup.relative != "absolute" and control != TWIST:  # a velocity has no reference
        layers.append(Relative(control, to=setup.relative, **speeds))
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


SAME = (1e-3, 1e-2)
"""By how much a controller's TCP may be off [m, rad]: as much as a driver's tolerance of a pose."""


def native_space(setup: Setup, arm: ArmDescription) -> dict[str, spaces.Box]:
    """Return the space of what an arm's controller is sent: poses, or twists within the speeds of the description."""
    if setup.control != TWIST:
        return {TQUAT: tquat_space()}
    bound = np.repeat([arm.tcp_speed, arm.tcp_turn_speed], 3)
    return {TWIST: spaces.Box(-bound, bound, dtype=np.float64)}


def require_native(parts: Parts) -> None:
    """Check that what a setup has fits `native`, where it is set.

    Raises:
        InvalidSetup: A gate looks at joints; or a real arm does not take poses or twists, or has another TCP.
    """
    setup = parts.setup
    if not setup.native:
        return
    if jointwise := [str(gate) for gate in parts.gates if gate.needs_joints]:
        raise InvalidSetup(
            f"The gate {jointwise[0]} looks at joints, and with native=True the controllers of real arms choose them. "
            "Leave the gate out, or native."
        )
    kind = CommandKind.twist if setup.control == TWIST else CommandKind.pose
    for robot in parts.robots:
        arm = parts.devices.arms.get(robot.name)
        if arm is None:
            continue
        own = _tcp_in_flange(robot)
        text = ", ".join(f"{number:g}" for number in np.round(own.tquat, 6) + 0.0)
        if kind not in arm.commands():
            known = ", ".join(sorted(one.name for one in arm.commands()))
            raise InvalidSetup(
                f"native=True and control={setup.control!r} need an arm that takes {kind.name}; {arm.name} takes "
                f"{known}. Use native=False or, where its driver has the option 'tcp', give it: [{text}]."
            )
        given = parts.devices.tcp.get(robot.name)
        if given is not None and not Pose.from_tquat(given).is_close(own, *SAME):
            raise InvalidSetup(
                f"The site gives {arm.name} the TCP {list(given)}; that of {robot.name} in this setup is [{text}], and "
                "its controller would lead another point. Give it this one as the option 'tcp'."
            )


def _tcp_in_flange(robot: RobotPlacement) -> Pose:
    home = np.array(robot.arm.home)
    return kinematics_of(robot.arm).forward(home).inverse() * kinematics_of(robot.arm, robot.end_effector).forward(home)
