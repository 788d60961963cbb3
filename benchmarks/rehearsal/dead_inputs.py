"""A person at a device without hardware, which dies in mid-motion; a part of `teleop.py`."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import rcs
from rcs.kinematics import kinematics_of
from rcs.teleop import Button, HandReading, InputDevice, Operator, Reading

HAND_HZ = 72.0
"""Rate of the device, that of a Quest 3."""
FATES = ("silent", "lost", "hangs")


@dataclass
class Person(InputDevice):
    """A hand that is where it is put, at the rate of a device."""

    clock: Callable[[], float] = time.monotonic
    hand: HandReading | Callable[[float], HandReading] = field(default_factory=HandReading)
    fate: str = ""
    valid_for = 0.1
    next: float = 0.0
    is_open: bool = False

    def open(self) -> None:
        """Connect."""
        if self.fate == "lost":
            raise rcs.errors.DeviceFault("the cable is out")
        self.next, self.is_open = self.clock(), True

    def read(self) -> Reading | None:
        """Return where the hand is, when it is due."""
        if self.clock is time.monotonic:
            time.sleep(max(self.next - time.monotonic(), 0.0))
        while self.fate == "hangs" and self.is_open:
            time.sleep(0.005)
        if self.fate == "lost":
            raise rcs.errors.DeviceFault("the cable is out")
        now = self.clock()
        if self.fate or now < self.next:
            self.next = max(self.next, now + 0.01) if self.fate else self.next
            return None
        self.next += 1.0 / HAND_HZ
        self.next = max(self.next, now - 1.0 / HAND_HZ)
        return Reading(time=now, hands={"right": self.hand(now) if callable(self.hand) else self.hand})

    def close(self) -> None:
        """Disconnect."""
        self.is_open = False


def held(pose: Sequence[float], *buttons: Button, **others: Any) -> HandReading:
    """Return a hand with buttons held down."""
    return HandReading(pose=np.array(pose, np.float64), buttons=frozenset(buttons), **others)


def drop(times: int, seed: int) -> list[dict[str, Any]]:
    """Kill a device in mid-motion again and again; `--drop` of `teleop.py` says what is measured.

    Args:
        times: Deaths per fate.
        seed: Seed of the moments.
    """
    random = np.random.default_rng(seed)
    results: list[dict[str, Any]] = []
    for hardware in (None, "sim"):
        for fate in FATES:
            stepping: Any = "async" if hardware else "realtime"
            person = Person()
            with rcs.make("Free", hardware=hardware, stepping=stepping, max_episode_steps=None) as env:
                operator = Operator(env, person)
                state: Any = env.reset(seed=0)
                operator.reset(*state)
                ways, backs, speeds = [], [], []
                for i in range(times):
                    seconds, way = float(random.uniform(0.6, 1.2)), 0.1 * (-1) ** i
                    state, trace = _run(env, operator, person, state, seconds, "clutch", way=way)
                    speeds.append(_speed(trace))
                    died, person.fate = time.monotonic(), fate
                    state, trace = _run(env, operator, person, state, 0.7)
                    ways.append(_way([row for row in trace if row[0] > died + person.valid_for + 0.1]))
                    person.fate = ""
                    state, trace = _run(env, operator, person, state, 1.6)
                    backs.append(_way(trace))
                operator.close()
            results.append(
                {
                    "hardware": hardware or "simulation", "fate": fate, "times": times,
                    "worst_way_mm": 1e3 * max(ways), "back_way_mm": 1e3 * max(backs), "speed_m_s": max(speeds),
                }
            )  # fmt: skip
    results.append(_blocked(times, random))
    return results


def _blocked(times: int, random: np.random.Generator) -> dict[str, Any]:
    """Block the loop in mid-motion for 2 s, and ask the arm itself where it is."""
    person = Person()
    with rcs.make("Free", hardware="sim", stepping="async", max_episode_steps=None) as env:
        operator, robot = Operator(env, person), env.robots["fr3"]
        arm: Any = env.stack.ports[0].device
        kinematics = kinematics_of(robot.arm, robot.end_effector)
        state: Any = env.reset(seed=0)
        operator.reset(*state)
        ways, moved, backs, speeds = [], [], [], []
        for i in range(times):
            seconds, way = float(random.uniform(0.6, 1.2)), 0.1 * (-1) ** i
            state, trace = _run(env, operator, person, state, seconds, "clutch", way=way)
            speeds.append(_speed(trace))
            blocked, trace = time.monotonic(), []
            while time.monotonic() < blocked + 2.0:
                trace.append((time.monotonic(), kinematics.forward(np.array(arm.state().joints)).tquat[:3]))
                time.sleep(0.005)
            moved.append(_way(trace))
            ways.append(_way([row for row in trace if row[0] > blocked + person.valid_for + 0.1]))
            state, trace = _run(env, operator, person, state, 0.5)
            backs.append(_way(trace))
        operator.close()
    return {
        "hardware": "sim", "fate": "blocked", "times": times, "worst_way_mm": 1e3 * max(ways),
        "back_way_mm": 1e3 * max(backs), "speed_m_s": max(speeds), "way_before_mm": 1e3 * float(np.median(moved)),
    }  # fmt: skip


def _run(
    env: rcs.envs.Env,
    operator: Operator,
    person: Person,
    state: Any,
    seconds: float,
    *buttons: Button,
    way: float = 0.0,
) -> tuple[Any, list[tuple[float, Any]]]:
    """Move a hand at a speed for some time; return the last state, and when the TCP was where."""
    began, trace = time.monotonic(), []

    def hand(now: float) -> HandReading:
        passed = now - began  # the clutch is pressed anew each time
        place = way * max(passed - 0.2, 0.0)
        return held((0.0, place, 1.0, 0, 0, 0, 1), *(buttons if passed > 0.2 else ()))

    person.hand = hand
    observation, info = state
    while time.monotonic() < began + seconds:
        observation, _, _, truncated, info = env.step(operator.act(observation, info))
        if truncated:
            raise SystemExit(f"The robot has stopped, so that nothing can be measured: {info.get('faults')}")
        trace.append((time.monotonic(), np.array(observation["tquat"][:3])))
    return (observation, info), trace


def _way(trace: list[tuple[float, Any]]) -> float:
    places = np.array([place for _, place in trace])
    return float(np.linalg.norm(places - places[0], axis=1).max())


def _speed(trace: list[tuple[float, Any]]) -> float:
    times, places = np.array([row[0] for row in trace]), np.array([row[1] for row in trace])
    ways = np.linalg.norm(places[3:] - places[:-3], axis=1)
    return float((ways / (times[3:] - times[:-3])).max())
