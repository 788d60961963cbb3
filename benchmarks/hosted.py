"""Devices with a host: how long it takes to start one, to reach it, and to hold when either side fails.

    python benchmarks/hosted.py [--tries 20]

Prints one line of JSON. `hold_p99_ms`: from a command that is valid for 50 ms to the hold, while the program keeps the
interpreter. `orphan_ms`: from SIGKILL of the program to the hold, the longest. `hang_ms`: from a call that does not
return to the fault, the longest. The arm is a fake: what its vendor's controller takes comes on top.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests/hardware"))  # for `unruly`, whose arms say when they hold
from unruly import drop, holds

from rcs.hardware import Site
from rcs.robots.fr3.description import FR3

HOME = np.array(FR3.home)
FAR = HOME + 0.5
ORPHAN = "import sys; sys.path[:0] = {path!r}; import hosted; hosted.orphan({box!r})"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--tries", type=int, default=20)
    tries = parser.parse_args().tries
    with tempfile.TemporaryDirectory(prefix="rcs", dir="/tmp") as folder:
        os.environ["RCS_HOSTS"] = folder
        box = Path(folder)
        result = {**reach(box), **hold_in_time(box, tries), **orphans(box, tries), **hangs(box, min(tries, 10))}
    print(json.dumps({"benchmark": "hosted", **result}))


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


def hold_in_time(box: Path, tries: int) -> dict[str, float]:
    """Measure how late commands end that are valid for 50 ms while the main thread keeps the interpreter."""
    late = []
    with arm_in(box) as arm:
        for _ in range(tries):
            before, begin = len(holds(box)), time.monotonic()
            arm.command_joints(FAR, 0.05)
            while time.monotonic() < begin + 0.2:
                re.match(r"(a+)+$", "a" * 22 + "b")  # 0.1 s in one call of C
            late.append(1e3 * (holds(box)[before] - begin))
    return {"hold_p99_ms": round(float(np.percentile(late, 99)), 1), "hold_p50_ms": round(float(np.median(late)), 1)}


def orphan(box: str) -> None:
    """Be a program that moves its arm until it is killed."""
    arm = arm_in(Path(box))
    arm.open()
    while True:
        arm.command_joints(FAR, 10.0)
        print(flush=True)
        time.sleep(0.03)


def orphans(box: Path, tries: int) -> dict[str, float]:
    """Measure how long an arm goes on whose program is killed."""
    program = ORPHAN.format(path=[str(Path(__file__).parent)], box=str(box))
    took = []
    for _ in range(tries):
        process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
        assert process.stdout is not None
        process.stdout.readline()
        before, begin = len(holds(box)), time.monotonic()
        process.send_signal(signal.SIGKILL)
        while len(holds(box)) == before:
            time.sleep(0.001)
        took.append(1e3 * (holds(box)[before] - begin))
        process.communicate()
    return {"orphan_ms": round(max(took), 1)}


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


if __name__ == "__main__":
    main()
