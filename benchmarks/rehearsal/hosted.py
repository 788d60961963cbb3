"""The time to start a host of devices, to reach it, and to detect that it hangs.

`hang_ms`: from a call that does not return to the fault, the longest. The arm is a fake: what its vendor's controller
takes comes on top.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

sys.path.append(str(Path(__file__).parents[2] / "tests/hardware"))  # for `unruly`, whose arms say when they hold
from unruly import drop

from rcs.hardware import Site
from rcs.robots.fr3 import FR3

HOME = np.array(FR3.home)


def measure(tries: int) -> dict[str, float]:
    """Measure all three, hangs several times."""
    with tempfile.TemporaryDirectory(prefix="rcs", dir="/tmp") as folder, patch.dict(os.environ, RCS_HOSTS=folder):
        return {**reach(Path(folder)), **hangs(Path(folder), tries)}


def arm_in(box: Path) -> Any:
    """Return an arm whose host logs its holds."""
    given: Any = {"driver": "unruly:UnrulyDriver", "address": "benchmark", "options": {"box": str(box)}}
    return Site(arms={"fr3": given}).devices({"fr3": (FR3, None)}, {}).arms["fr3"]


def reach(box: Path) -> dict[str, float]:
    """Measure start, state, command and hold."""
    arm, begin = arm_in(box), time.perf_counter()
    with arm:
        start = time.perf_counter() - begin
        calls: dict[str, Callable[[], object]] = {
            "state": arm.state,
            "command": lambda: arm.command_joints(HOME, 0.1),
            "hold": arm.hold,
        }
        found: dict[str, float] = {"start_ms": round(1e3 * start)}
        for name, call in calls.items():
            times = []
            for _ in range(500):
                begin = time.perf_counter()
                call()
                times.append(time.perf_counter() - begin)
                time.sleep(0.001)
            for share in (50, 99):
                found[f"{name}_p{share}_us"] = round(1e6 * float(np.percentile(times, share)), 1)
        return found


def hangs(box: Path, tries: int) -> dict[str, float]:
    """Measure how long it takes until a host that hangs is a fault."""
    took = []
    with arm_in(box) as arm:
        for _ in range(tries):
            begin = time.monotonic()
            drop(box, "state", "hang")
            while not arm.fault:
                time.sleep(0.001)
            took.append(1e3 * (time.monotonic() - begin))
            arm.recover()
    return {"hang_ms": round(max(took), 1)}
