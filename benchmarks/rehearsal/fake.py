"""A servo in Python that follows its points at once: random commands on a clock of its own, and late ticks."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from rehearsal.sent import next_target, worst
from rehearsal.stage import RATES, Array

from rcs.devices import ArmLimits, ArmState, StreamedArm, StreamOptions, StreamPoint
from rcs.robots import FR3

PERIOD = 1 / 30
"""Between commands [s]."""
LIMITS = ArmLimits(FR3.joint_lower, FR3.joint_upper, FR3.velocity_limit, FR3.acceleration_limit, FR3.jerk_limit)


class Servo(StreamedArm):
    """An arm that is where the points say, and keeps them."""

    def __init__(self, options: StreamOptions) -> None:
        """Stand at the home posture of the FR3."""
        super().__init__("servo", LIMITS, options)
        self.joints = np.array(FR3.home)
        self.points: list[Array] = []

    def _read(self) -> ArmState:
        return ArmState(self.joints, np.zeros_like(self.joints))

    def _write(self, point: StreamPoint) -> None:
        self.joints = point.position
        self.points.append(self.joints)

    def _stop(self) -> None:
        pass


class Driven(Servo):
    """The same on a clock of its own, with a random command now and then: too early, too late, or none for long."""

    def __init__(self, commands: int, rate: float, seed: int = 0) -> None:
        """Take so many commands."""
        super().__init__(StreamOptions(rate=rate, is_paced_by_read=True, tracking_error=10.0))
        self.left, self._wait, self._ticks = commands, 1, round(rate * PERIOD)
        self._random, self._target = np.random.default_rng(seed), self.joints

    def _write(self, point: StreamPoint) -> None:
        super()._write(point)
        self._wait -= 1
        if self._wait > 0 or not self.left:
            return
        self.left -= 1
        self._target = next_target(self._random, self._target, LIMITS.joint_lower, LIMITS.joint_upper)
        self.command_joints(self._target)
        late = self._random.random()
        self._wait = int(self._ticks * (1.0 if late < 0.8 else self._random.uniform(0.1, 4.0)))


def drive(commands: int, rate: float) -> dict[str, Any]:
    """Send random commands as fast as the arm takes them."""
    arm = Driven(commands, rate)
    with arm:
        arm.command_joints(np.array(FR3.home))
        while arm.left:
            time.sleep(0.01)
        clamped = arm.clamped()
    points = np.array(arm.points)
    times = np.arange(len(points)) / rate
    return {"rate": rate, "commands": commands, **worst(times, points, rate, LIMITS), "clamped": clamped}


def keep_time(rate: float, seconds: float) -> float:
    """Lead an arm in real time beside a loop that commands it; return the share of ticks that were left out."""
    random = np.random.default_rng(0)
    with Servo(StreamOptions(rate=rate, missed_ticks=10_000)) as arm:
        target = np.array(FR3.home)
        begin = time.monotonic()
        for k in range(round(seconds / PERIOD)):
            arm.command_joints(target)
            target = np.clip(target + random.normal(0.0, 0.01, 7), LIMITS.joint_lower, LIMITS.joint_upper)
            time.sleep(max(begin + (k + 1) * PERIOD - time.monotonic(), 0.0))
        return round(arm.missed_ticks / max(arm.ticks + arm.missed_ticks, 1), 5)


def measure(commands: int, seconds: float) -> dict[str, Any]:
    """Return the figures of the servo."""
    with Servo(StreamOptions()) as arm:
        advice = arm.real_time_advice
    late = {f"{rate:g} Hz": keep_time(rate, seconds / len(RATES)) for rate in RATES.values()}
    return {**drive(commands, 250.0), "late_ticks": late, "real_time": not advice}
