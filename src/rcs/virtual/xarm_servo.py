"""Servo mode of an xArm's controller: how it leads the joints along the points that a client sends.

The controller leads the joints to the newest point until the next one is due, without limits of its own, and stops
where a real one does: joints that are too fast (C24), a TCP that is too fast (C60), joints that do not follow (C31).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

import numpy as np

from rcs.virtual.virtual_robot import VirtualRobot
from rcs.virtual.xarm_messages import Code, Vector

RATE: Final = 500
"""Ticks per second [Hz]: two per cycle of the controller, which has 250 Hz."""
CYCLE: Final = 2
"""Ticks per cycle: the time that the controller takes for a single point."""
LONGEST_GAP: Final = RATE // 25
"""Ticks between points up to which they are a stream, whose speed is kept; the vendor asks for 30 to 250 Hz."""
JOINT_SPEED: Final = 1.02 * np.pi
"""Joint speed above which C24 follows [rad/s]: the vendor's 180 degrees/s, with 2 % for the rounding of floats."""
TCP_SPEED: Final = 1.2
"""TCP speed above which C60 follows in servo mode [m/s]: by the vendor, 1.2 times the largest speed of linear moves."""
WINDOW: Final = 20
"""Ticks over which the servos smooth points and speeds are measured, since points arrive early and late; ours."""
TRACKING_LIMIT: Final = 0.3
"""Largest distance of a joint from its reference at the usual collision sensitivity of 3 [rad]; ours."""
BUSY_TICKS: Final = RATE // 5
"""Ticks after a point for which the arm counts as moving; ours."""


class ServoMode:
    """Leads the joints of an arm to the newest point."""

    def __init__(self, robot: VirtualRobot, place: Callable[[Vector], Vector]) -> None:
        """Start without a point.

        Args:
            robot: The arm.
            place: Returns the position of the TCP [m], shape (3,), at joints (dof,).
        """
        self._robot = robot
        self._place = place
        self._ticks = 0
        self._goal: Vector | None = None
        self._pointed = -BUSY_TICKS
        self.reference = robot.joints
        """Where the joints are led [rad], shape (dof,)."""
        self._gap = self._left = float(CYCLE)
        self._past: deque[Vector] = deque(maxlen=WINDOW)

    @property
    def newest(self) -> Vector:
        """The newest point, or where the joints are led without one [rad], shape (dof,)."""
        return self.reference if self._goal is None else self._goal

    @property
    def is_moving(self) -> bool:
        """Whether there was a point a short time ago."""
        return self._ticks - self._pointed < BUSY_TICKS

    def tick(self) -> None:
        """Let a tick pass."""
        self._ticks += 1

    def start(self) -> None:
        """Start a stream of points from where the arm was commanded last."""
        self._goal = None
        self.reference = self._robot.commanded
        self._past.extend([self.reference] * WINDOW)

    def end(self) -> None:
        """Forget all points."""
        self._goal = None
        self._pointed = -BUSY_TICKS

    def take(self, joints: Vector) -> None:
        """Take a point [rad], shape (dof,), in place of the one before."""
        gap = self._ticks - self._pointed
        if gap:
            self._gap += 0.2 * (gap - self._gap) if gap < LONGEST_GAP else CYCLE - self._gap
            self._left = max(self._gap, CYCLE)
        self._goal = joints
        self._pointed = self._ticks

    def advance(self, sensitivity: int) -> tuple[Code, str] | None:
        """Lead the joints for one tick.

        Args:
            sensitivity: Sensitivity to collisions, 0 to 5.

        Returns:
            The error that stops the arm, and its reason; None if there is none.
        """
        reference = self.reference
        if self._goal is not None and self._left > 0:
            reference = reference + (self._goal - reference) / max(self._left, 1.0)
            self._left -= 1
        speeds = (reference - self._past[0]) * RATE / WINDOW
        if self._goal is not None and (trouble := self._trouble_at(reference, speeds, sensitivity)):
            return trouble
        self.reference = reference
        self._past.append(reference)
        self._robot.lead(np.mean(self._past, axis=0), speeds)
        return None

    def _trouble_at(self, reference: Vector, speeds: Vector, sensitivity: int) -> tuple[Code, str] | None:
        """Return the error of leading the joints to a reference, and its reason."""
        if (fastest := np.abs(speeds)).max() > JOINT_SPEED:
            return Code.JOINT_SPEED, f"joint {fastest.argmax() + 1} is too fast"
        way = self._place(reference) - self._place(self._past[0])
        if np.linalg.norm(way) * RATE / WINDOW > TCP_SPEED:
            return Code.TCP_SPEED, "the TCP is too fast"
        apart = np.abs(self._robot.commanded - self._robot.joints)
        if apart.max() * sensitivity > 3 * TRACKING_LIMIT:
            return Code.COLLISION, f"joint {apart.argmax() + 1} does not follow"
        return None
