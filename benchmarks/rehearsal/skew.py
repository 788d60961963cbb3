"""Two virtual FR3 in one environment at 90 Hz: by how much later one of them is given what both are commanded at once.

Both wrists jerk at the same steps, from standing still; a command shows in the robot's log as the first torque that is
another one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from rehearsal.stage import OPEN, Array, percentile, stage

FREQUENCY = 90.0
EVERY = 18
"""Steps between two jerks, in which the wrist stands still."""
WAY = 0.02
"""Amplitude of the wrist's motion [rad]."""
JUMP = 0.05
"""Smallest change that counts as a new torque [N·m]."""
SEARCH = 0.12
"""How long after the step a torque is looked for [s]."""


def onset(times: Array, torques: Array, at: float) -> float | None:
    """Return when a torque first leaves what it was, after a moment; None where it does not."""
    first, last = np.searchsorted(times, [at, at + SEARCH])
    before = torques[max(first - 20, 0) : first]
    if len(before) == 0:
        return None
    away = np.abs(torques[first:last] - before.mean()) > JUMP + 4 * before.std()
    return float(times[first + away.argmax()]) if away.any() else None


def measure(seconds: float) -> dict[str, Any]:
    """Return the figures of two arms that are commanded for so long."""
    sent: list[float] = []
    late: list[float] = []
    fault = ""
    with stage("dual_fr3") as one:
        with one.env(frequency=FREQUENCY) as env:
            env.reset()
            for k in range(round(FREQUENCY * seconds)):
                action = np.zeros(7)
                if k % EVERY == EVERY // 2:
                    action[6] = WAY if k // EVERY % 2 else -WAY
                both = {"joints": action, "gripper": OPEN}
                *_, truncated, info = env.step({"left": both, "right": both})
                if action.any():
                    sent.append(info["time"] - 1 / FREQUENCY)
                late.append(1e3 * info["late"])
                if truncated:
                    fault = str(info.get("faults", info["end"]))
                    break
        one.virtual.close()
        points = [one.points(name) for name in ("left", "right")]
        robot_late = one.robot_late()
    pairs = [[onset(arm["time"], arm["torques"][:, 6], at - 5e-3) for arm in points] for at in sent]
    skews = [1e3 * abs(left - right) for left, right in pairs if left is not None and right is not None]
    return {
        "skew_p99_ms": percentile(skews, 99, 2),
        "skew_p50_ms": percentile(skews, 50, 2),
        "commands": len(skews),
        "of": len(sent),
        "seconds": round(len(late) / FREQUENCY, 1),
        "fault": fault,
        "loop_late_p99_ms": percentile(late, 99),
        "robot_late": robot_late,
    }
