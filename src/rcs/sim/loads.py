"""Forces on a simulated arm: measurements of its sensors, and its reaction to collisions."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rcs._core import ArmBody, ArmLoads, CollisionReaction
from rcs.robots.description import CollisionLimits
from rcs.sim.robot import SimRobot

_WRENCH = ("force along x", "force along y", "force along z", "moment about x", "moment about y", "moment about z")


class SimLoads:
    """Torques of an arm's drives and the wrench on its tool, of the last physics step of every copy."""

    def __init__(self, robot: SimRobot) -> None:
        """Start to measure a robot's loads."""
        self._world = robot.world
        self._dof = robot.placement.arm.dof
        self._first = robot.world.core.measure(ArmLoads(_body(robot)))
        robot.world.refresh()

    @property
    def joint_torques(self) -> NDArray[np.float64]:
        """Torques of the drives [Nm], including those that carry the arm's weight, (*leading, dof)."""
        return self._world.measurements[..., self._first : self._first + self._dof].copy()

    @property
    def tcp_wrench(self) -> NDArray[np.float64]:
        """Force [N], and moment about the TCP [Nm], of all contacts of the tool, (*leading, 6).

        The axes are those of the base. The weight of a held object counts, that of the tool does not.
        """
        first = self._first + self._dof
        return self._world.measurements[..., first : first + 6].copy()


class CollisionGuard:
    """Has an arm react to collisions: the step ends, as `StepEnd.fault`."""

    def __init__(self, robot: SimRobot, limits: CollisionLimits) -> None:
        """Watch a robot from now on, in every copy of its world."""
        core = robot.world.core
        self._joints = robot.placement.arm.joints
        self._limits = (*limits.joint_torque, *[limits.force] * 3, *[limits.moment] * 3)
        self._reaction = CollisionReaction(
            _body(robot),
            list(limits.joint_torque),
            [limits.force] * 3 + [limits.moment] * 3,
            limits.loads == "drive",
            limits.time_constant,
            limits.duration,
            core.copies,
        )
        core.fault_when(self._reaction)

    def reason(self, copy: int) -> str:
        """Return which limit was exceeded in a copy since its reset; empty if none was."""
        index, load = self._reaction.cause(copy)
        if index < 0:
            return ""
        dof = len(self._joints)
        what = f"torque at {self._joints[index]}" if index < dof else _WRENCH[index - dof]
        unit = "N" if 0 <= index - dof < 3 else "Nm"
        return f"collision: {what} is {math.fabs(load):.1f} {unit}, the limit is {self._limits[index]:g} {unit}"


def _body(robot: SimRobot) -> ArmBody:
    layout = robot.layout
    return ArmBody(robot.world.model, layout.joint_ids, layout.tcp_site, layout.base_body)
