"""Inputs that die in mid-motion: a stand-in without hardware, or the real input with its other end killed."""

from __future__ import annotations

import json
import os
import struct
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rcs_data.files.closing import Closing
from rehearsal.other_ends import ENDS, End, Want

import rcs
from rcs.kinematics import kinematics_of
from rcs.rollout.interactive.page_link import PATH, PageKeys, PageLink
from rcs.teleop import Button, HandReading, InputDevice, Keyboard, Operator, Pedal, Reading
from rcs.teleop.device_file import DeviceFile
from rcs.teleop.input_events import InputEvents

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
    beside: Sequence[InputDevice] = ()
    waits = 0.2
    """Time after which it moves [s], from when on the clutch is pressed."""
    joints: Any = None
    """The robot's joints when a motion begins [rad]."""
    next: float = 0.0
    is_open: bool = False

    @property
    def device(self) -> InputDevice:
        """The input."""
        return self

    def start(self) -> None:
        """Begin to send; the device is open."""

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


class OtherEnd(Closing):
    """The other end of an input, which moves and dies like a `Person`."""

    joints: Any = None

    def __init__(self, name: str) -> None:
        self._folder = tempfile.TemporaryDirectory()
        os.environ["XDG_CONFIG_HOME"] = self._folder.name
        self._end = {**ENDS, "page": Page, "pedal": Foot}[name](Path(self._folder.name))
        self._send, self._end.send = self._end.send, lambda want: self._send(self._want())
        self._led: Any = None
        self.device, self.beside = self._end.device, self._end.beside
        self.valid_for, self.waits = self.device.valid_for, 0.2 if self.device.has_clutch else 1.6
        self.hand: Callable[[float], HandReading] = lambda now: held((0.0, 0.0, 1.0, 0, 0, 0, 1))
        self._fate = ""

    @property
    def fate(self) -> str:
        """How it has died; empty if it lives."""
        return self._fate

    @fate.setter
    def fate(self, fate: str) -> None:
        self._fate = fate
        self._end.die(bool(fate))

    def start(self) -> None:
        """Begin to send; the device is open."""
        self._end.start()

    def _want(self) -> Want:
        hand = self.hand(time.monotonic())
        assert hand.pose is not None
        _, y, z = hand.pose[:3]
        if self.joints is not None and (hand.buttons or z > 1.0):  # otherwise a leader stays where it was left
            self._led = self.joints + (3.0 * y + z - 1.0) * np.eye(len(self.joints))[0]
        way = np.array([0.0, 0.1 * np.sign(y), 0.0, 0.0, 0.0, 0.0])
        return Want(hand.pose, way, self._led, buttons=hand.buttons)

    def close(self) -> None:
        """End it."""
        self._end.close()
        self._folder.cleanup()


class Page(End):
    """A page in the browser with keys, of which one is held while it moves."""

    rate = 20.0

    def __init__(self, folder: Path) -> None:
        super().__init__()
        from websockets.sync.client import connect

        self._link = link = PageLink(lambda page: None)
        token = link.admit(1).partition('"token": "')[2].partition('"')[0]
        link.leader = 1
        self.device = Keyboard(keys=PageKeys(link))
        self._page: Any = connect(f"ws://127.0.0.1:{link.port}{PATH}?{token}")

    def send(self, want: Want) -> None:
        """Say which keys are held."""
        keys = ["ad"[int(want.way[1] < 0)]] if want.buttons and want.way[1] else []
        self._page.send(json.dumps({"time": 1e3 * time.monotonic(), "is_seen": True, "keys": keys}))

    def close(self) -> None:
        """Close it."""
        super().close()
        self._page.close()
        self._link.close()


class Foot(End):
    """A pedal beside a `Person`, through a file like the kernel's; it dies by being unplugged."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        os.mkfifo(folder / "pedal")
        self._person, self._path, self._file = Person(), str(folder / "pedal"), -1

        class Plugged(Pedal):
            def connect(own) -> InputEvents:  # noqa: N805
                keys = InputEvents(self._path, "pedal")
                keys._file = DeviceFile(self._path, "pedal", "")
                return keys

        self.device, self.beside = self._person, [Plugged(self._path)]

    def start(self) -> None:
        """Plug it in."""
        self.die(False)
        super().start()

    def send(self, want: Want) -> None:
        """Press or release it."""
        self._person.hand = HandReading(pose=want.pose)
        os.write(self._file, struct.pack("@llHHi", 0, 0, 1, 30, "clutch" in want.buttons))

    def die(self, is_dead: bool) -> None:
        """Unplug it, or plug it in."""
        super().die(True)
        time.sleep(2.0 / self.rate)  # nobody writes
        if is_dead:
            os.close(self._file)
        else:
            self._file = os.open(self._path, os.O_RDWR)
            super().die(False)


def drop(times: int, seed: int, name: str | None = None) -> list[dict[str, Any]]:
    """Kill a device in mid-motion again and again; `--drop` of `teleop.py` says what is measured.

    Args:
        times: Deaths per fate.
        seed: Seed of the moments.
        name: The input whose other end is killed; None for a stand-in that dies in several ways.
    """
    random = np.random.default_rng(seed)
    results: list[dict[str, Any]] = []
    for hardware in (None, "sim"):
        for fate in FATES if name is None else ("killed",):
            stepping: Any = "async" if hardware else "realtime"
            robot = "so101" if name == "so101_leader" else "fr3"
            with ExitStack() as stack:
                person = Person() if name is None else stack.enter_context(OtherEnd(name))
                env = rcs.make("Free", robot=robot, hardware=hardware, stepping=stepping, max_episode_steps=None)
                operator = Operator(stack.enter_context(env), person.device, beside=person.beside)
                stack.callback(operator.close)
                state: Any = env.reset(seed=0)
                operator.reset(*state)
                person.start()
                ways, backs, speeds = [], [], []
                for i in range(times):
                    seconds, way = person.waits + float(random.uniform(0.4, 1.0)), 0.1 * (-1) ** i
                    state, trace = _run(env, operator, person, state, seconds, "clutch", way=way)
                    speeds.append(_speed(trace))
                    if speeds[-1] < 0.02:
                        raise SystemExit(f"The robot did not move, so that nothing can be measured: {operator.problem}")
                    died, person.fate = time.monotonic(), fate
                    state, trace = _run(env, operator, person, state, 0.7)
                    ways.append(_way([row for row in trace if row[0] > died + person.valid_for + 0.1]))
                    person.fate = ""
                    state, trace = _run(env, operator, person, state, 1.6)
                    backs.append(_way(trace))
            results.append(
                {
                    "input": name or "stand-in", "hardware": hardware or "simulation", "fate": fate, "times": times,
                    "worst_way_mm": 1e3 * max(ways), "back_way_mm": 1e3 * max(backs), "speed_m_s": max(speeds),
                }
            )  # fmt: skip
    return results if name else [*results, _blocked(times, random)]


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
    person: Person | OtherEnd,
    state: Any,
    seconds: float,
    *buttons: Button,
    way: float = 0.0,
) -> tuple[Any, list[tuple[float, Any]]]:
    """Move a hand at a speed for some time; return the last state, and when the TCP was where."""
    began, trace = time.monotonic(), []
    observation, info = state

    def hand(now: float) -> HandReading:
        passed = now - began  # the clutch is pressed anew each time, and a leader without one moved
        place, is_pressed = way * max(passed - person.waits, 0.0), bool(buttons) and passed > 0.2
        height = 1.05 if buttons and not is_pressed else 1.0
        return held((0.0, place, height, 0, 0, 0, 1), *(buttons if is_pressed else ()))

    if buttons:
        person.joints = np.array(observation["joints"])
    person.hand = hand
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
