"""Arms whose own controllers lead the TCP: what they are sent, and what a setup with `native` needs of them."""

from __future__ import annotations

import numpy as np
from gymnasium import spaces

from rcs.devices import CommandKind
from rcs.envs.parts import Parts
from rcs.envs.setup import Setup
from rcs.envs.spaces import TQUAT, TWIST, tquat_space
from rcs.errors import InvalidSetup
from rcs.kinematics import kinematics_of
from rcs.robots.description import ArmDescription
from rcs.sim.scene import RobotPlacement
from rcs.spatial import Pose

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
        told = ", ".join(f"{number:g}" for number in np.round(own.tquat, 6) + 0.0)
        if kind not in arm.commands():
            known = ", ".join(sorted(one.name for one in arm.commands()))
            raise InvalidSetup(
                f"native=True and control={setup.control!r} need an arm that takes {kind.name}; {arm.name} takes "
                f"{known}. Use native=False or, where its driver has the option 'tcp', give it: [{told}]."
            )
        given = parts.devices.tcp.get(robot.name)
        if given is not None and not Pose.from_tquat(given).is_close(own, *SAME):
            raise InvalidSetup(
                f"The site gives {arm.name} the TCP {list(given)}; that of {robot.name} in this setup is [{told}], and "
                "its controller would lead another point. Give it this one as the option 'tcp'."
            )


def _tcp_in_flange(robot: RobotPlacement) -> Pose:
    home = np.array(robot.arm.home)
    return kinematics_of(robot.arm).forward(home).inverse() * kinematics_of(robot.arm, robot.end_effector).forward(home)
