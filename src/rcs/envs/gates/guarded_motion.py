"""The motion of all arms that a guard checks: their way in a step, and while they brake after it.

The motions of simulated arms predict the next step to the bit. A real arm is followed by the same law of motion, from
where it was measured last at rest and by the targets that it was sent.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from rcs._core import Motion, Trajectory
from rcs.sim.robot import RobotLayout
from rcs.sim.scene import RobotPlacement
from rcs.sim.world import World

TICK = 0.01
"""Time between two places of a way [s]: an arm at 20 rad/s² leaves the straight line between them by 0.25 mrad."""

Joints = Mapping[str, NDArray[np.float64]]
"""Joints of every robot [rad], (dof,) each."""


class GuardedMotions:
    """The motions of all arms, one copy at a time."""

    def __init__(
        self, robots: Sequence[RobotPlacement], world: World | None, real: Collection[str], period: float
    ) -> None:
        """Look the motions up.

        Args:
            robots: The robots.
            world: World of the simulated ones.
            real: Names of the robots whose arms are not.
            period: Control period [s].
        """
        self._world, self._period = world, period
        self._simulated: dict[str, Motion] = {}
        self._orders: list[int] = []
        self._real: dict[str, tuple[Trajectory, NDArray[np.float64]]] = {}
        for robot in robots:
            arm = robot.arm
            if world is None or robot.name in real:
                self._real[robot.name] = Trajectory(arm.motion_limits), np.zeros(Trajectory.size(arm.dof))
                continue
            ids = RobotLayout.of(robot, world.model)
            motion = Motion(ids.joint_ids, ids.actuator_ids, ids.motion, arm.motion_limits, world.copies)
            self._simulated[robot.name] = world.core.add_motion(motion)
            self._orders.append(ids.motion + Trajectory.size(arm.dof) - 1)
        self._names = [robot.name for robot in robots]

    def stand(self, joints: Joints) -> None:
        """Take the real ones among these arms to stand where they are measured."""
        for name in self._real.keys() & joints.keys():
            _, memory = self._real[name]
            memory[:] = 0.0
            for row in Trajectory.POSITION_ROWS:
                memory[row * len(joints[name]) : (row + 1) * len(joints[name])] = joints[name]

    def sent(self, targets: Joints) -> None:
        """Follow real arms through a step to targets."""
        for name, (trajectory, memory) in self._real.items():
            memory[: len(targets[name])] = targets[name]
            trajectory.follow(memory, self._period)
            trajectory.advance(memory, self._period)

    def can_hold(self) -> bool:
        """Return whether `hold` reaches all arms: those that are simulated."""
        return not self._real

    def hold(self, copies: NDArray[np.bool_]) -> None:
        """Have the arms of some copies brake to rest in the next step, instead of going to their targets."""
        userdata = None if self._world is None else self._world.userdata
        for order in self._orders:
            assert userdata is not None, "the scene has given every arm its user data"
            userdata[..., order][copies] = 1.0

    def ways(self, copy: int, targets: Joints | None) -> list[NDArray[np.float64]]:
        """Return where every arm is led in a step to targets and while it then brakes to rest, (n, dof) each.

        Places are `TICK` apart at most, and of the same times for all arms. Without targets, all hold.
        """
        ways: list[NDArray[np.float64]] = []
        for name in self._names:
            if name in self._real:
                ways.append(self._way_of_real(*self._real[name], None if targets is None else targets[name]))
                continue
            assert self._world is not None, "simulated arms are in a world"
            target = np.empty(0) if targets is None else np.ascontiguousarray(targets[name])
            ways.append(self._world.core.preview(self._simulated[name], target, copy, TICK))
        longest = max(map(len, ways))
        return [np.concatenate([way, np.repeat(way[-1:], longest - len(way), axis=0)]) for way in ways]

    def _way_of_real(
        self, trajectory: Trajectory, memory: NDArray[np.float64], target: NDArray[np.float64] | None
    ) -> NDArray[np.float64]:
        memory = memory.copy()
        places: list[NDArray[np.float64]] = []
        ticks = int(np.ceil(self._period / TICK - 1e-9))
        pace = self._period / ticks
        if target is not None:
            memory[: len(target)] = target
            trajectory.follow(memory, self._period)
            places += [trajectory.state(memory, k * pace)[0] for k in range(ticks)]
            trajectory.advance(memory, self._period)
        trajectory.brake(memory)
        last = int(np.ceil(trajectory.remaining(memory) / pace))
        return np.array(places + [trajectory.state(memory, k * pace)[0] for k in range(last + 1)])
