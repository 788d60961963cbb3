"""Cause every fault of a virtual robot at random times of a motion, and measure its report and effects.

A fault must end the episode within 100 ms (within 300 ms if the controller hangs or the cable is cut), the rows so far
must be kept, nothing may move at `recover`, and the robot must work afterwards. Other events must have no effect.
"""

from __future__ import annotations

import tempfile
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from rcs_data import Dataset
from rehearsal.stage import OPEN, Stage, percentile, recover, stage

import rcs
from rcs.devices import lookup
from rcs.errors import RcsError
from rcs.virtual.fault import GENERIC

Words = tuple[str, ...]

SPEED = 0.2
"""Speed of the first and last joint, as a fraction of the largest."""
PATIENCE = 1.2
"""Timeout for a fault [s]."""
STANDS = 0.6
"""Time from a fault to standstill [s]."""
WATCHED = 0.3
"""Time after `recover` during which nothing may move [s]."""
SOME = ("freeze 2", "cut", "late 20/100", "lose 3", "lose 1/100", "corrupt 3", "corrupt 1/100")
"""Faults of all robots to cause."""
CODES = {"fr3": ("0", "5", "9"), "so101": ("2", "4", "8"), "xarm7": ("21", "31", "35")}
"""Codes by robot, for those with a fault `code`."""
VERSIONS = {"fr3": "9", "ur5e": "1", "xarm7": "1.8.0", "so101": "1234"}
"""Others than the drivers speak with; who is connected notices nothing, but for the FR3, which hangs up."""
GRIPPER_CODE = "10"


def words_of(robot: str, kind: str, random: np.random.Generator) -> Words:
    """Return what to tell of a kind of fault, with a joint or a code by chance."""
    match kind:
        case "overload":
            return (kind, str(random.choice(lookup.find("arm", robot).joints)))
        case "code":
            return (kind, str(random.choice(CODES[robot])))
        case "version":
            return (kind, VERSIONS[robot])
        case "gripper":
            return (kind, GRIPPER_CODE)
        case _:
            return tuple(kind.split())


def try_fault(one: Stage, env: rcs.Env, words: Words, random: np.random.Generator) -> dict[str, Any]:
    """Cause a fault in motion, recover, and return the measurements."""
    away = begin(env)["joints"] - np.array(lookup.find("arm", one.robot).home)
    shape, steps = env.action_space["joints"].shape, 0
    most = SPEED * env.action_space["joints"].high * np.where(away > 0.0, -1.0, 1.0)  # never to an end
    at: list[float] = []
    moment = time.monotonic() + random.uniform(0.4, 1.2)
    timer = threading.Timer(moment - time.monotonic(), lambda: (at.append(time.monotonic()), one.virtual.tell(*words)))
    timer.start()
    detected, says = None, ""
    while not at or time.monotonic() < at[0] + PATIENCE:
        way = np.sin(2.0 * steps / 30) * np.ones(shape)
        way[1:-1] *= 0.1
        *_, truncated, info = env.step({"joints": way * most, "gripper": OPEN})
        steps += 1
        if truncated:
            says = str(info.get("faults", info["end"]))
            detected = 1e3 * (time.monotonic() - at[0]) if at else None
            break
    timer.cancel()
    timer.join()
    time.sleep(STANDS)
    one.virtual.tell("clear")
    time.sleep(STANDS)
    recovers = time.monotonic()
    failure = recover(env)
    end = time.monotonic() + WATCHED
    time.sleep(WATCHED)
    return {
        "is_early": not at,
        "ms": detected,
        "says": says,
        "steps": steps,
        "recover": (recovers, end),
        "failure": failure,
    }


def begin(env: rcs.Env) -> dict[str, Any]:
    """Begin an episode, whatever the last one has left, and return the first observation."""
    try:
        return env.reset()[0]
    except RcsError:
        time.sleep(1.0)
        recover(env)
        return env.reset()[0]


def works(env: rcs.Env) -> str:
    """Return why the robot does not work after a reset, or nothing."""
    try:
        env.reset()
        action = {"joints": np.zeros(env.action_space["joints"].shape), "gripper": OPEN}
        for _ in range(6):
            *_, truncated, info = env.step(action)
            if truncated:
                return str(info.get("faults", info["end"]))
    except RcsError as err:
        return str(err)
    return ""


def measure(robot: str, tries: int) -> dict[str, Any]:
    """Return the figures of every fault of a robot, with so many tries each."""
    own = [name for name in lookup.find("wire", robot).faults if name not in GENERIC]
    return {kind: try_kind(robot, kind, tries) for kind in (*SOME, *own)}


def try_kind(robot: str, kind: str, tries: int) -> dict[str, Any]:
    """Return the figures of one fault."""
    random, seen, broken = np.random.default_rng(0), [], []
    with stage(robot) as one, tempfile.TemporaryDirectory(prefix="rcs", dir="/tmp") as folder:
        with one.env() as env, rcs.record_all(env, Path(folder) / "rows"):
            for _ in range(tries):
                seen.append(try_fault(one, env, words_of(robot, kind, random), random))
                if trouble := works(env):
                    broken.append(trouble)
                    recover(env)
        kept = [episode.steps(["action/joints"]).num_rows for episode in Dataset.open(Path(folder) / "rows").episodes]
        one.virtual.close()
        ticks = one.ticks()
    moved = []
    for trial in seen:
        begin, end = np.searchsorted(ticks["time"], trial["recover"])
        joints = ticks["joints"][begin:end]
        if len(joints):
            moved.append(1e3 * float(np.abs(joints - joints[0]).max()))
    left, missing = Counter(kept), 0
    for steps in sorted(trial["steps"] for trial in seen if trial["says"]):
        # The step that a fault ends is a row if the devices could still be measured.
        found = next((length for length in (steps, steps + 1) if left[length]), None)
        missing += found is None
        left[found or 0] -= 1
    times = [trial["ms"] for trial in seen]
    return {
        "n": tries - sum(trial["is_early"] for trial in seen),
        "faults_before": sum(trial["is_early"] for trial in seen),
        "detected": sum(one is not None for one in times),
        "p50_ms": percentile(times, 50),
        "p99_ms": percentile(times, 99),
        "max_ms": percentile(times, 100),
        "rows_lost": missing,
        "moved_mrad": percentile(moved, 100),
        "moved_unknown": tries - len(moved),
        "recover_failed": [trial["failure"] for trial in seen if trial["failure"]][:1],
        "works_not": len(broken),
        **({"because": broken[0]} if broken else {}),
        "says": next((trial["says"] for trial in seen if trial["says"]), ""),
    }
