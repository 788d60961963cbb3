"""What a robot is sent while it is commanded at random: worst speed, acceleration and jerk, and how many ticks come late.

    python benchmarks/hardware.py --robot fake --commands 10000 --seconds 10

The figures are shares of the limits, by differencing the points as they were written. `fake` is a servo in Python that
follows its points at once: its commands come as fast as it goes, on its own clock; its late ticks are those of a 30 Hz
loop in real time. The last line is the result as JSON.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.devices import ArmLimits, ArmState, StreamedArm, StreamOptions, StreamPoint
from rcs.robots import FR3

PERIOD = 1 / 30
"""Between commands [s]."""
LIMITS = ArmLimits(FR3.joint_lower, FR3.joint_upper, FR3.velocity_limit, FR3.acceleration_limit, FR3.jerk_limit)
RATES = (1000.0, 500.0, 250.0, 100.0)
"""At which arms are streamed to [Hz]: FR3, UR5e, xArm7, SO101."""

Array = NDArray[np.float64]


def worst(points: Array, rate: float, limits: ArmLimits) -> dict[str, float]:
    """Return the largest speed, acceleration and jerk of points (N, dof) at a rate [Hz], in shares of the limits."""
    speed, acceleration, jerk = (np.abs(np.diff(points, k, axis=0)).max(axis=0) * rate**k for k in (1, 2, 3))
    outside = (points < limits.joint_lower) | (points > limits.joint_upper)
    return {
        "worst_speed": round(float((speed / limits.joint_velocity).max()), 4),
        "worst_acceleration": round(float((acceleration / limits.joint_acceleration).max()), 4),
        "worst_jerk": round(float((jerk / limits.joint_jerk).max()), 4),
        "outside": int(outside.any(axis=1).sum()),
    }


def next_target(random: np.random.Generator, target: Array, limits: ArmLimits) -> Array:
    """Return a target: anywhere, at the ends of the ranges, a step away, or a small step away."""
    lower, upper = limits.joint_lower, limits.joint_upper
    kind = random.random()
    if kind < 0.3:
        return random.uniform(lower, upper)
    if kind < 0.35:
        return np.where(random.random(len(lower)) < 0.5, lower, upper)
    return np.clip(target + random.normal(0.0, 0.2 if kind < 0.5 else 0.02, len(lower)), lower, upper)


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
        self._target = next_target(self._random, self._target, LIMITS)
        self.command_joints(self._target)
        late = self._random.random()
        self._wait = int(self._ticks * (1.0 if late < 0.8 else self._random.uniform(0.1, 4.0)))


def drive(commands: int, rate: float) -> dict[str, Any]:
    """Send random commands as fast as the arm takes them."""
    arm = Driven(commands, rate)
    with arm:
        arm.command_joints(FR3.home)
        while arm.left:
            time.sleep(0.01)
        clamped = arm.clamped()
    return {"rate": rate, "commands": commands, **worst(np.array(arm.points), rate, LIMITS), "clamped": clamped}


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


def measure_fake(commands: int, seconds: float) -> dict[str, Any]:
    """Return the figures of the servo."""
    with Servo(StreamOptions()) as arm:
        advice = arm.real_time_advice
    late = {f"{rate:g} Hz": keep_time(rate, seconds / len(RATES)) for rate in RATES}
    return {**drive(commands, 250.0), "late_ticks": late, "real_time": not advice}


ROBOTS = {"fake": measure_fake}


def main() -> None:
    """Print a line for the robot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", choices=ROBOTS, default="fake", help="what is measured")
    parser.add_argument("--commands", type=int, default=10_000, help="random commands")
    parser.add_argument("--seconds", type=float, default=10.0, help="in real time, for late ticks")
    chosen = parser.parse_args()
    print(json.dumps({"robot": chosen.robot, **ROBOTS[chosen.robot](chosen.commands, chosen.seconds)}))


if __name__ == "__main__":
    main()
