"""The straight motion of a TCP to a pose within limits of speed and acceleration, tick by tick."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rcs.spatial import Pose

REACH = 0.9
"""Fraction of the acceleration limit used for braking at the target."""


class TcpRamp:
    """A setpoint of the TCP that moves from pose to pose, with separate limits for translation and rotation."""

    def __init__(self, start: Pose, speeds: tuple[float, float], accelerations: tuple[float, float]) -> None:
        """Start at rest.

        Args:
            start: Pose of the TCP in the base.
            speeds: Limits of the translation [m/s] and the rotation [rad/s].
            accelerations: Limits of the translation [m/s²] and the rotation [rad/s²].
        """
        self.pose = start
        """Setpoint of the TCP in the base."""
        self._limits = tuple(zip(speeds, accelerations, strict=True))
        self._twist = np.zeros(6)

    @property
    def is_still(self) -> bool:
        """True if the setpoint is at rest."""
        return not self._twist.any()

    def advance(self, goal: Pose | None, dt: float) -> Pose:
        """Advance by a tick of `dt` [s] towards a goal in the base, or brake if None; return the new setpoint."""
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
    """Return the velocity during the next tick."""
    distance = float(np.linalg.norm(way))
    # The last tick ends at the goal; from every earlier one, braking at the goal is possible.
    fastest = min(speed, distance / dt, float(np.sqrt(2.0 * REACH * acceleration * distance)))
    wanted = way * (fastest / distance) if distance > 0 else np.zeros(3)
    change = wanted - velocity
    most, needed = acceleration * dt, float(np.linalg.norm(change))
    return wanted if needed <= most else velocity + change * (most / needed)
