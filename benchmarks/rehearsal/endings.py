"""Measure how long a robot continues after its program has become busy, or has ended, in motion.

A child process leads the first joint at a constant speed through an environment, and ends. By the robot's log: from the
end to where the speed falls below a share of what it was, and to where the robot stands.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from rehearsal.stage import GRIPPERS, OPEN, Array, Stage, percentile, stage

VALID_FOR = 0.05
BUSY = 5.0
"""Time for which the GIL is held [s]."""
SPEEDS = {"fr3": 0.6, "ur5e": 0.6, "xarm7": 0.3, "so101": 1.0}
"""Speeds of the first joint [rad/s]."""
CRUISE = 0.9
"""Time in motion before the end [s]."""
ENDS = ("sigkill", "sigterm", "exception", "exit")
CHILD = "import sys; sys.path[:0] = {path!r}; from rehearsal import endings; endings.be_program(*{words!r})"
WINDOW = {"so101": 0.06}
"""Over which speeds are measured [s]: longer where positions are rounded to steps of the encoder."""
AT_SPEED = {"so101": 0.9, "fr3": 0.9}
"""Share of the speed below which a robot brakes; where points are exact, 0.98: a UR needs 7 ms to lose that, and 17 ms
to lose a tenth."""
STANDS = 0.05
"""Share of the speed below which the robot stands."""


def be_program(site: str, robot: str, end: str, way: float) -> None:
    """Move the robot in one direction, announce the end, and end."""
    import rcs

    env = rcs.make("Free", robot=robot, hardware=site, end_effector=GRIPPERS.get(robot), max_episode_steps=None)
    env.reset()
    step = np.zeros(env.action_space["joints"].shape)
    step[0] = way * SPEEDS[robot] / 30
    until = time.monotonic() + CRUISE
    while time.monotonic() < until:
        *_, truncated, info = env.step({"joints": step, "gripper": OPEN})
        if truncated:
            raise SystemExit(str(info))
    print(time.monotonic(), flush=True)
    if end == "exception":
        raise RuntimeError("a mistake in the program")
    while end != "exit":
        env.step({"joints": step, "gripper": OPEN})


def end_program(one: Stage, end: str, way: float) -> float:
    """End a program in motion and return the time."""
    path = one.log.with_name("site.json")
    one.site.write(path)
    words = (str(path), one.robot, end, way)
    child = CHILD.format(path=[str(Path(__file__).parents[1])], words=words)
    process = subprocess.Popen([sys.executable, "-c", child], stdout=subprocess.PIPE)
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line:
        raise RuntimeError(f"the program with {one.robot} has not begun (exit code {process.wait()})")
    at = float(line)
    if end.startswith("sig"):
        time.sleep(0.1)
        at = time.monotonic()
        process.send_signal(signal.SIGKILL if end == "sigkill" else signal.SIGTERM)
    process.communicate()
    time.sleep(1.0)
    return at


def keep_interpreter(seconds: float) -> None:
    """Hold the GIL in C calls, the last of which takes half of the time."""
    letters, begin = 18, time.monotonic()
    while time.monotonic() < begin + seconds:
        re.match(r"(a+)+$", "a" * letters + "b")  # takes twice as long with each letter
        letters += 1


def be_busy(one: Stage, way: float) -> float:
    """Lead the robot with commands that are valid for 50 ms, keep the interpreter; return when the last was sent."""
    arm, _ = one.devices()
    with arm:
        target = np.array(arm.state().joints)
        begin = sent = time.monotonic()
        while sent < begin + CRUISE:
            target[0] += way * SPEEDS[one.robot] / 30
            arm.command_joints(target, VALID_FOR)
            sent = time.monotonic()
            time.sleep(max(1 / 30 - (time.monotonic() - begin) % (1 / 30), 0.0))
        arm.command_joints(target + way * SPEEDS[one.robot] / 30 * np.eye(len(target))[0], VALID_FOR)
        sent = time.monotonic()
        keep_interpreter(BUSY)
    time.sleep(0.5)
    return sent


def braking(times: Array, places: Array, at: float, window: float, share: float) -> tuple[float, float] | None:
    """Return how long after a moment a joint (N,) begins to brake, and how long after it it stands [ms].

    None where it did not move. While no points come, the joint is where the last one was.
    """
    here = (times > at - 0.4) & (times < at + 8.0)
    times, places = times[here], places[here]
    grid = np.arange(at - 0.35, at + 7.0, 1e-3)
    last = np.searchsorted(times, grid, side="right") - 1
    smooth = np.interp(grid, times, places)
    following = times[np.minimum(last + 1, len(times) - 1)]
    smooth = np.where((last >= 0) & (following - times[last] > 0.1), places[last], smooth)
    half = round(window * 500)
    speeds = np.abs(smooth[2 * half :] - smooth[: -2 * half]) / (2e-3 * half)
    grid = grid[half:-half]
    usual = float(np.median(speeds[(grid > at - 0.2) & (grid < at - half * 1e-3)]))
    if usual < 0.05:
        return None
    stands = grid[(grid > at) & (speeds < STANDS * usual)][0]
    brakes = grid[(grid < stands) & (speeds > share * usual)][-1]
    return 1e3 * (brakes - at), 1e3 * (stands - at)


def measure(robot: str, tries: int) -> dict[str, Any]:
    """Return the figures of a robot, with so many tries each."""
    events: list[tuple[str, float]] = []
    with stage(robot) as one:
        for k in range(tries):
            events.append(("hold", be_busy(one, (-1.0) ** k)))
            events += [(end, end_program(one, end, (-1.0) ** (k + n))) for n, end in enumerate(ENDS, 1)]
        one.virtual.close()
        ticks, points, late = one.ticks(), one.points(), one.robot_late()
    times, places = (ticks["time"], ticks["joints"]) if robot == "fr3" else (points["time"], points["joints"])
    window = WINDOW.get(robot, 0.02)
    found: dict[str, Any] = {"tries": tries}
    for kind in ("hold", *ENDS):
        times_of = [
            braking(times, places[:, 0], at, window, AT_SPEED.get(robot, 0.98)) for name, at in events if name == kind
        ]
        brakes = [one[0] for one in times_of if one]
        found[kind] = {
            "n": len(brakes),
            "brakes_p50_ms": percentile(brakes, 50),
            "brakes_p99_ms": percentile(brakes, 99),
            "stands_max_ms": percentile([one[1] for one in times_of if one], 100),
        }
    if unknown := [kind for kind in ("hold", *ENDS) if found[kind]["n"] < tries]:
        return {"failed": f"the robot did not move before some of the ends: {', '.join(unknown)}", **found}
    return {
        "hold_p99_ms": found["hold"]["brakes_p99_ms"],
        "orphan_ms": max(found[end]["brakes_p99_ms"] for end in ENDS),
        **found,
        "robot_late": late,
    }
