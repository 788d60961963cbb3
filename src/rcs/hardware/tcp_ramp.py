"""Where a TCP is led on its way to a pose: straight, within a speed and an acceleration, tick by tick."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rcs.spatial import Pose

REACH = 0.9
"""Share of the acceleration that braking at the target is planned with."""


class TcpRamp:
    """A TCP that goes from pose to pose; translation and rotation each keep their limits."""

    def __init__(self, start: Pose, speeds: tuple[float, float], accelerations: tuple[float, float]) -> None:
        """Stand at a pose.

        Args:
            start: In the base.
            speeds: Largest of the translation [m/s] and of the rotation [rad/s].
            accelerations: Likewise [m/s², rad/s²].
        """
        self.pose = start
        """Where the TCP is led, in the base."""
        self._limits = tuple(zip(speeds, accelerations, strict=True))
        self._twist = np.zeros(6)

    @property
    def is_still(self) -> bool:
        """Whether it stands."""
        return not self._twist.any()

    def advance(self, goal: Pose | None, dt: float) -> Pose:
        """Go on for a tick [s], to a goal or, without one, to rest; return where that is."""
        ways = np.zeros(6)
        if goal is not None:
            ways[:3] = goal.translation - self.pose.translation
            ways[3:] = (goal * self.pose.inverse()).rotvec
        for part, (speed, acceleration) in zip((slice(0, 3), slice(3, 6)), self._limits, strict=True):
            self._twist[part] = _next(self._twist[part], ways[part], speed, acceleration, dt)
        turn = Pose.from_rotvec((0.0, 0.0, 0.0), self._twist[3:] * dt) * self.pose
        self.pose = Pose(self.pose.translation + self._twist[:3] * dt, turn.quaternion)
        return self.pose


def _next(
    velocity: NDArray[np.float64], way: NDArray[np.float64], speed: float, acceleration: float, dt: float
) -> NDArray[np.float64]:
    """Return the velocity of the next tick."""
    distance = float(np.linalg.norm(way))
    # The last tick ends at the goal, and from every one before it can be stopped there.
    fastest = min(speed, distance / dt, float(np.sqrt(2.0 * REACH * acceleration * distance)))
    wanted = way * (fastest / distance) if distance > 0 else np.zeros(3)
    change = wanted - velocity
    most, needed = acceleration * dt, float(np.linalg.norm(change))
    return wanted if needed <= most else velocity + change * (most / needed)
