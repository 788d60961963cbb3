"""Servo mode of an xArm controller, which moves the joints along a client's setpoints.

The controller moves the joints to the newest setpoint until the next one is due, without limits of its own, and stops
like a real one if joints are too fast (C24), the TCP is too fast (C60), or joints do not follow (C31).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

import numpy as np

from rcs.virtual.virtual_robot import VirtualRobot
from rcs.virtual.xarm_messages import Code, Vector

RATE: Final = 500
"""Ticks per second [Hz]: two per cycle of the controller, which runs at 250 Hz."""
CYCLE: Final = 2
"""Ticks per cycle, the duration of the motion to a single setpoint."""
LONGEST_GAP: Final = RATE // 25
"""Most ticks between setpoints of a stream, whose speed is kept; the vendor recommends 30 to 250 Hz."""
JOINT_SPEED: Final = 1.02 * np.pi
"""Joint speed that causes C24 [rad/s]: the vendor's 180 degrees/s, plus 2 % for the rounding of floats."""
TCP_SPEED: Final = 1.2
"""TCP speed that causes C60 in servo mode [m/s]: 1.2 times the largest speed of linear moves, as the vendor states."""
WINDOW: Final = 20
"""Ticks over which setpoints are smoothed and speeds measured, since setpoints have jitter; our choice."""
TRACKING_LIMIT: Final = 0.3
"""Largest tracking error of a joint at the default collision sensitivity of 3 [rad]; our choice."""
BUSY_TICKS: Final = RATE // 5
"""Ticks after a setpoint for which the arm counts as moving; our choice."""


class ServoMode:
    """Moves the joints of an arm to the newest setpoint."""

    def __init__(self, robot: VirtualRobot, place: Callable[[Vector], Vector]) -> None:
        """Start without a setpoint.

        Args:
            robot: The arm.
            place: Returns the position of the TCP [m], shape (3,), for joints [rad], shape (dof,).
        """
        self._robot = robot
        self._place = place
        self._ticks = 0
        self._goal: Vector | None = None
        self._pointed = -BUSY_TICKS
        self.reference = robot.joints
        """Reference of the joints [rad], shape (dof,)."""
        self._gap = self._left = float(CYCLE)
        self._past: deque[Vector] = deque(maxlen=WINDOW)

    @property
    def newest(self) -> Vector:
        """The newest setpoint, or the reference without one [rad], shape (dof,)."""
        return self.reference if self._goal is None else self._goal

    @property
    def is_moving(self) -> bool:
        """True if a setpoint has arrived within `BUSY_TICKS`."""
        return self._ticks - self._pointed < BUSY_TICKS

    def tick(self) -> None:
        """Count a tick."""
        self._ticks += 1

    def start(self) -> None:
        """Start a stream of setpoints at the last commanded position."""
        self._goal = None
        self.reference = self._robot.commanded
        self._past.extend([self.reference] * WINDOW)

    def end(self) -> None:
        """Discard all setpoints."""
        self._goal = None
        self._pointed = -BUSY_TICKS

    def take(self, joints: Vector) -> None:
        """Replace the setpoint [rad], shape (dof,)."""
        gap = self._ticks - self._pointed
        if gap:
            self._gap += 0.2 * (gap - self._gap) if gap < LONGEST_GAP else CYCLE - self._gap
            self._left = max(self._gap, CYCLE)
        self._goal = joints
        self._pointed = self._ticks

    def advance(self, sensitivity: int) -> tuple[Code, str] | None:
        """Move the joints for one tick.

        Args:
            sensitivity: Collision sensitivity, 0 to 5.

        Returns:
            The error that stops the arm and its reason; None without an error.
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
        """Return the error that a reference causes and its reason; None without an error."""
        if (fastest := np.abs(speeds)).max() > JOINT_SPEED:
            return Code.JOINT_SPEED, f"joint {fastest.argmax() + 1} is too fast"
        way = self._place(reference) - self._place(self._past[0])
        if np.linalg.norm(way) * RATE / WINDOW > TCP_SPEED:
            return Code.TCP_SPEED, "the TCP is too fast"
        apart = np.abs(self._robot.commanded - self._robot.joints)
        if apart.max() * sensitivity > 3 * TRACKING_LIMIT:
            return Code.COLLISION, f"joint {apart.argmax() + 1} does not follow"
        return None
