"""Every fault that a virtual robot knows, at random moments of a motion: when it is told, and what follows.

A fault must end the episode within 100 ms (a controller that hangs, or a cable that is out, within 300), the rows until
then stay, nothing moves at `recover`, and the robot works again after it. What is no fault must not disturb.
"""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rcs_data import Dataset

import rcs
from rcs.devices import lookup
from rcs.errors import RcsError
from rcs.virtual.fault import GENERIC
from rehearsal.stage import OPEN, Stage, percentile, stage

Words = tuple[str, ...]

PATIENCE = 1.2
"""How long a fault is waited for [s]."""
STANDS = 0.6
"""After a fault, until the robot stands [s]."""
WATCHED = 0.3
"""After `recover`, for how long nothing may move [s]."""
RECOVERY = 8.0
"""How long to try [s]; a UR's protective stop lasts 5 s."""
HARMLESS = {"late", "lose", "corrupt"}
"""With the values below."""
GENERIC_WORDS: tuple[Words, ...] = (
    ("freeze", "2"),
    ("cut",),
    ("late", "20/100"),
    ("lose", "3"),
    ("lose", "1/100"),
    ("corrupt", "3"),
    ("corrupt", "1/100"),
)
CODES = {"fr3": ("0", "5", "9"), "so101": ("2", "4", "8"), "xarm7": ("21", "31", "35")}
"""Of the robots that have a fault `code`."""
VERSIONS = {"fr3": "9", "ur5e": "1", "xarm7": "1.8.0", "so101": "1234"}
"""Others than the drivers speak with; who is connected notices nothing, but for the FR3, which hangs up."""
GRIPPER_CODE = "10"


def told_of(robot: str, name: str) -> list[Callable[[np.random.Generator], Words]]:
    """Return what to tell of a fault of a robot, as functions of chance."""
    arm = lookup.find("arm", robot)
    match name:
        case "overload":
            return [lambda random: (name, str(random.choice(arm.joints)))]
        case "code":
            return [lambda random: (name, str(random.choice(CODES[robot])))]
        case "version":
            return [lambda _: (name, VERSIONS[robot])]
        case "gripper":
            return [lambda _: (name, GRIPPER_CODE)]
        case _:
            return [lambda _: (name,)]


def try_fault(one: Stage, env: rcs.Env, words: Words, random: np.random.Generator) -> dict[str, Any]:
    """Have something go wrong in motion, recover, and return what was seen."""
    env.reset()
    shape, steps = env.action_space["joints"].shape, 0
    most = 0.5 * env.action_space["joints"].high
    at: list[float] = []
    moment = time.monotonic() + random.uniform(0.4, 1.2)
    timer = threading.Timer(moment - time.monotonic(), lambda: (at.append(time.monotonic()), one.virtual.tell(*words)))
    timer.start()
    detected, says = None, ""
    while not at or time.monotonic() < at[0] + PATIENCE:
        way = np.cos(2.0 * steps / 30) * np.ones(shape)
        way[1:-1] *= 0.1
        *_, truncated, info = env.step({"joints": way * most, "gripper": OPEN})
        steps += 1
        if truncated:
            detected, says = 1e3 * (time.monotonic() - at[0]) if at else np.nan, str(info.get("faults", info["end"]))
            break
    timer.join()
    time.sleep(STANDS)
    one.virtual.tell("clear")
    time.sleep(0.1)
    begin = time.monotonic()
    failure = recover(env)
    end = time.monotonic() + WATCHED
    time.sleep(WATCHED)
    return {"ms": detected, "says": says, "steps": steps, "recover": (begin, end), "failure": failure}


def recover(env: rcs.Env) -> str:
    """Recover, and return why that fails, or nothing."""
    until = time.monotonic() + RECOVERY
    while True:
        try:
            env.recover()
            return ""
        except RcsError as err:
            if time.monotonic() > until:
                return str(err)
            time.sleep(0.2)


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
    found: dict[str, Any] = {}
    own = [name for name in lookup.find("wire", robot).faults if name not in GENERIC]
    kinds: list[tuple[str, Callable[[np.random.Generator], Words]]] = [
        (" ".join(words), lambda _, words=words: words) for words in GENERIC_WORDS
    ]
    kinds += [(name, say) for name in own for say in told_of(robot, name)]
    for kind, say in kinds:
        found[kind] = try_kind(robot, say, tries)
    return found


def try_kind(robot: str, say: Callable[[np.random.Generator], Words], tries: int) -> dict[str, Any]:
    """Return the figures of one fault."""
    random, seen, broken = np.random.default_rng(0), [], []
    with stage(robot) as one, tempfile.TemporaryDirectory(prefix="rcs", dir="/tmp") as folder:
        with one.env() as env, rcs.record_all(env, Path(folder) / "rows"):
            for _ in range(tries):
                seen.append(try_fault(one, env, say(random), random))
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
        moved.append(1e3 * float(np.abs(joints - joints[0]).max(initial=0.0)) if len(joints) else np.nan)
    missing = sum(trial["steps"] not in kept for trial in seen)
    times = [trial["ms"] for trial in seen]
    return {
        "n": tries,
        "detected": sum(one is not None for one in times),
        "p50_ms": percentile(times, 50),
        "p99_ms": percentile(times, 99),
        "max_ms": percentile(times, 100),
        "rows_lost": missing,
        "moved_mrad": round(max(moved), 2),
        "recover_failed": [trial["failure"] for trial in seen if trial["failure"]][:1],
        "works_not": len(broken),
        **({"because": broken[0]} if broken else {}),
        "says": next((trial["says"] for trial in seen if trial["says"]), ""),
    }
