"""An input device whose hand moves as a function of time, and what it leads, for tests."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import rcs
from rcs.errors import DeviceFault
from rcs.teleop import Button, HandReading, InputDevice, Operator, Reading

LEVEL = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def at(*place: float, rotation: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)) -> np.ndarray:
    """A pose of a hand."""
    return np.array([*place, *rotation])


class ScriptedDevice(InputDevice):
    """Samples a script at its own rate. `kill` makes it silent, fail or hang."""

    def __init__(
        self,
        script: Callable[[float], HandReading | Mapping[str, HandReading] | None],
        *,
        clock: Callable[[], float] = time.monotonic,
        rate: float = 72.0,
        hands: tuple[str, ...] = ("right",),
        has_clutch: bool = True,
        is_waiting: bool = False,
    ) -> None:
        self.script, self.clock, self.rate = script, clock, rate
        self.hands, self.has_clutch = hands, has_clutch
        self.valid_for = 0.1
        self.fate = ""
        self.opened = 0
        self.start = 0.0
        self.shown: Mapping[str, Any] = {}
        self._is_waiting, self._last, self._end = is_waiting, -1.0, threading.Event()

    def open(self) -> None:
        if self.fate == "lost":
            raise DeviceFault("the cable is out")
        self.opened += 1
        self.start = self.clock()
        self._last = -1.0
        self._end.clear()

    def read(self) -> Reading | None:
        if self._is_waiting:
            self._end.wait(1.0 / self.rate)
        if self.fate == "lost":
            raise DeviceFault("the cable is out")
        while self.fate == "hangs" and not self._end.wait(0.01):
            pass
        number = np.floor((self.clock() - self.start) * self.rate + 1e-6)
        if self.fate == "silent" or number <= self._last:
            return None
        self._last = number
        sampled = number / self.rate
        hands = self.script(sampled)
        if hands is None:
            return None
        return Reading(
            time=self.start + sampled, hands={self.hands[0]: hands} if isinstance(hands, HandReading) else hands
        )

    def feedback(self, observation: Mapping[str, Any], info: Mapping[str, Any]) -> None:
        self.shown = info

    def close(self) -> None:
        self._end.set()


def held(pose: np.ndarray | None = None, *buttons: Button, **others: Any) -> HandReading:
    """A hand with buttons held down."""
    return HandReading(pose=pose, buttons=frozenset(buttons), **others)


@dataclass
class Led:
    """An environment that an operator leads, with what was measured."""

    env: rcs.envs.Env
    device: ScriptedDevice
    operator: Operator
    robot: str | None
    places: list[np.ndarray] = field(default_factory=list)
    targets: list[np.ndarray] = field(default_factory=list)
    observation: Mapping[str, Any] = field(default_factory=dict)
    info: dict[str, Any] = field(default_factory=dict)

    def own(self, nested: Mapping[str, Any]) -> Any:
        return nested if self.robot is None else nested[self.robot]

    @property
    def tcp(self) -> np.ndarray:
        return np.array(self.own(self.observation)["tquat"])

    def run(self, seconds: float) -> np.ndarray:
        """Go on, and return the TCP's poses of these steps, (steps, 7)."""
        start = len(self.places)
        for _ in range(round(seconds * self.env.frequency)):
            self.observation, _, _, _, self.info = self.env.step(self.operator.act(self.observation, self.info))
            self.env.note(**self.operator.notes())
            assert not self.info.get("faults"), self.info["faults"]
            self.places.append(self.tcp)
            self.targets.append(np.concatenate([np.ravel(one) for one in self.own(self.info["target"]).values()]))
        return np.array(self.places[start:])
