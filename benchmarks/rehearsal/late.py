"""Points that come late at the robot's rate, beside a loop of 30 Hz that records the robot and a camera."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from typing import Any

import numpy as np
from rehearsal.stage import OPEN, RATES, Array, percentile, stage

import rcs

CAMERAS = {"fr3": "side", "ur5e": "overhead", "xarm7": "front", "so101": "wrist"}
PAUSE = 0.25
"""After a longer pause, the points are another stream [s]."""


def left_out(times: Array, rate: float) -> float:
    """Return the share of a stream's points that should have come by its rate [Hz] and have not."""
    parts = np.split(times, np.flatnonzero(np.diff(times) > PAUSE) + 1)
    due = sum(round((part[-1] - part[0]) * rate) for part in parts if len(part))
    come = sum(len(part) - 1 for part in parts)
    return round(max(1.0 - come / max(due, 1), 0.0), 5)


def measure(robot: str, seconds: float) -> dict[str, Any]:
    """Return the figures of a robot that is led and recorded for so long."""
    with stage(robot) as one, tempfile.TemporaryDirectory(prefix="rcs", dir="/tmp") as folder:
        camera = CAMERAS[robot]
        site = replace(one.site, cameras={camera: "fake:0"})
        late: list[float] = []
        fault = ""
        with one.env(hardware=site, cameras=(camera,)) as env, rcs.record_all(env, folder):
            env.reset()
            step = np.zeros(env.action_space["joints"].shape)
            for k in range(round(30 * seconds)):
                step[0] = 0.3 / 30 * np.cos(2 * k / 30)
                *_, truncated, info = env.step({"joints": step, "gripper": OPEN})
                late.append(1e3 * info["late"])
                if truncated:
                    fault = str(info.get("faults", info["end"]))
                    break
        one.virtual.close()
        points = one.points()
        return {
            "late_ticks": left_out(points["time"], RATES[robot]),
            "rate": RATES[robot],
            "points": len(points),
            "fault": fault,
            "seconds": round(len(late) / 30, 1),
            "loop_late_p99_ms": percentile(late, 99),
            "robot_late": one.robot_late(),
        }
