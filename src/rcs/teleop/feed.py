"""The feed of a device's readings: a thread reads, a loop asks for the newest.

Between two questions, nothing of importance is lost: presses of buttons, and reasons to hold. Readings that make no
sense are left out and counted. A device that is lost is opened again; nothing moves on its own account when it is back,
since a hand that was held has to release the clutch and press it again, or a leader without one to be moved.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import get_args

import numpy as np
from numpy.typing import NDArray
from rcs_data.files.closing import Closing

from rcs.agents.agent import Event
from rcs.teleop.device import BUTTONS, OF_HANDS, Button, HandReading, InputDevice, Reading

_log = logging.getLogger(__name__)

LEAP = 0.3
"""A hand that is farther than this from the sample before has leapt [m]: tracking was lost, or its origin moved."""

JOINT_LEAP = 0.5
"""A leader's joint that is farther than this from the sample before has leapt [rad]: its servo has lost a turn."""

RETRY = 1.0
"""Time between two attempts to open a device that was lost [s]."""

AHEAD = 0.05
"""A reading that is farther ahead of the clock than this has a wrong time [s]."""

PATIENCE = 2.0
"""Longest time that `close` waits for the thread [s]."""

SILENT = "no reading yet"

REQUESTS: tuple[Event, ...] = get_args(Event)
"""Buttons that count also while nobody knows where the hand is, and after a silence."""


@dataclass(frozen=True, kw_only=True)
class News:
    """The news since the last question: readings, buttons and requests."""

    reading: Reading | None = None
    """The newest reading; None while it is stale, or there is none."""
    why: str = ""
    """Why there is no reading."""
    pressed: Mapping[str, Sequence[Button]] = field(default_factory=dict[str, Sequence[Button]])
    """Buttons that were pressed since, by hand, in their order; also without a reading, since requests are not lost."""
    requests: Sequence[Button] = ()
    """Requests made since at devices beside this one, in their order."""
    broken: Mapping[str, str] = field(default_factory=dict[str, str])
    """Why a hand could not be followed since, by hand."""


class Feed(Closing):
    """Reads a device and keeps the newest reading."""

    def __init__(
        self, device: InputDevice, *, clock: Callable[[], float] = time.monotonic, has_thread: bool = True
    ) -> None:
        """Take a device; nothing is connected.

        Args:
            device: The device.
            clock: Returns the time of readings [s].
            has_thread: Whether a thread reads; otherwise each question does, for a device that answers at once.
        """
        self.device = device
        self.counts: Counter[str] = Counter()
        """Readings that were left out, by their flaw."""
        self.readings = 0
        """Readings that were taken."""
        self._clock, self._has_thread = clock, has_thread
        self._lock = threading.Lock()
        self._must_end = threading.Event()
        """Ends the present thread; each has its own, so that one that was left behind does not go on."""
        self._thread: threading.Thread | None = None
        self.is_open = False
        """Whether the device was opened and not closed."""
        self._newest: Reading | None = None
        self._of_device: Mapping[str, int] = {}
        self._why = SILENT
        self._pressed: dict[str, list[Button]] = {}
        self._broken: dict[str, str] = {}

    def open(self) -> None:
        """Connect the device and begin to read.

        Raises:
            DeviceFault: The device is not there, or may not be opened.
            InvalidSetup: Its address makes no sense.
            MissingDependency: A package is not installed.
        """
        if self.is_open:
            return
        self.device.open()
        self.is_open = True
        self._must_end = threading.Event()
        if self._has_thread:
            name = f"rcs input {type(self.device).__name__}"
            self._thread = threading.Thread(target=self._run, args=(self._must_end,), name=name, daemon=True)
            self._thread.start()

    @property
    def left_out(self) -> Counter[str]:
        """Counts of what was left out, by flaw: readings, and messages that the device itself could not use."""
        with self._lock:
            return self.counts + Counter(self._of_device)

    def poll(self) -> News:
        """Return what has happened since the last question."""
        if not self._has_thread and (reading := self.device.read()) is not None:
            self._take(reading)
        now = self._clock()
        with self._lock:
            pressed, self._pressed = self._pressed, {}
            broken, self._broken = self._broken, {}
            newest = self._newest
            if newest is None:
                return News(why=self._why, pressed=pressed)
            age = now - newest.time
            if age > self.device.valid_for:
                return News(why=self._why or f"silent for {age:.2f} s", pressed=pressed)
            return News(reading=newest, pressed=pressed, broken=broken)

    def close(self) -> None:
        """End the thread and close the device. Closing twice is harmless."""
        self.is_open = False
        self._must_end.set()
        try:
            self.device.close()
        finally:
            if (thread := self._thread) is not None and thread is not threading.current_thread():
                thread.join(PATIENCE)
                if thread.is_alive():
                    _log.warning("%s has not returned from a call; its thread is left behind.", thread.name)
                self._thread = None

    def _run(self, must_end: threading.Event) -> None:
        is_lost, text = False, ""
        while not must_end.is_set():
            try:
                if is_lost:
                    self.device.close()
                    self.device.open()
                    is_lost = False
                    if must_end.is_set():  # it was closed meanwhile, before there was anything to close
                        self.device.close()
                        return
                reading = self.device.read()
                if reading is not None and not must_end.is_set():
                    self._take(reading)
            except Exception as err:  # noqa: BLE001  whatever it is, the device is lost, and the robot is held
                if must_end.is_set():
                    return
                is_lost = True
                with self._lock:
                    self._newest, self._why = None, f"{type(err).__name__}: {err}"
                    self.counts["lost"] += 1
                if self._why != text:
                    text = self._why
                    _log.warning("The input device is lost, and tried again every %g s: %s", RETRY, text)
                must_end.wait(RETRY)

    def _take(self, reading: Reading) -> None:
        now = self._clock()
        with self._lock:
            last, self._of_device = self._newest, reading.counts
            if flaw := flaw_of(reading, self.device.hands, last, now):
                self.counts[flaw] += 1
                return
            self.readings += 1
            is_fresh = last is not None and reading.time - last.time <= self.device.valid_for
            for name, hand in reading.hands.items():
                known = None if last is None else last.hands.get(name)
                if why := _break_of(hand, known if is_fresh else None):
                    self._broken[name] = why
                    # The clutch has to be pressed after that.
                    self._pressed[name] = [button for button in self._pressed.get(name, ()) if button != "clutch"]
                # In a first reading, also after a loss, the buttons may have been held for any time: they do not count.
                if known is not None and known.is_there and hand.is_there:
                    counting = BUTTONS if is_fresh and known.is_tracked and hand.is_tracked else REQUESTS
                    risen: list[Button] = [button for button in counting if button in hand.buttons - known.buttons]
                    self._pressed.setdefault(name, []).extend(risen)
            if not is_fresh and last is not None:
                self._broken.update(dict.fromkeys(reading.hands, f"silent for {reading.time - last.time:.2f} s"))
            self._newest, self._why = reading, ""


def with_buttons(news: News, beside: News, hands: Sequence[str], *, is_clutch: bool) -> News:
    """Return news with the buttons of a device beside: clutch, gripper and front count for all hands.

    While that is silent they are released, and what is held when it is back counts once it is pressed again. Its
    requests count also while the first device is silent or lost.

    Args:
        news: News of the device that leads.
        beside: News of the other one.
        hands: Names of the hands that lead.
        is_clutch: Whether the clutch is that of the other device alone; else that does not count.
    """
    clutch: frozenset[Button] = frozenset({"clutch"})
    reading, there = news.reading, () if beside.reading is None else beside.reading.hands.values()
    counting = (OF_HANDS if is_clutch else OF_HANDS - clutch) if there else frozenset[Button]()
    held = counting.intersection(button for hand in there for button in hand.buttons)
    tapped = [button for pressed in beside.pressed.values() for button in pressed]
    lost = clutch if is_clutch else frozenset[Button]()
    if reading is not None:
        joined = {name: replace(hand, buttons=hand.buttons - lost | held) for name, hand in reading.hands.items()}
        reading = replace(reading, hands=joined)
    pressed = {
        name: [
            *(button for button in news.pressed.get(name, ()) if button not in lost),
            *(button for button in tapped if button in counting),
        ]
        for name in hands
    }
    requests = [*news.requests, *(button for button in tapped if button not in OF_HANDS)]
    return replace(news, reading=reading, pressed=pressed, requests=requests)


def flaw_of(reading: Reading, hands: Sequence[str], last: Reading | None, now: float) -> str:
    """Return why a reading cannot be used, in a word or two; empty if it can.

    Args:
        reading: The reading.
        hands: The hands that the device has.
        last: The reading before; None for none.
        now: The present time [s].
    """
    if not math.isfinite(reading.time) or reading.time > now + AHEAD:
        return "wrong time"
    if last is not None and reading.time <= last.time:
        return "time runs backwards"
    if last is not None and reading.device_time is not None and reading.device_time == last.device_time:
        return "repeated"
    if not set(reading.hands) <= set(hands):
        return "unknown hand"
    return next((flaw for hand in reading.hands.values() if (flaw := _flaw_of_hand(hand))), "")


def _flaw_of_hand(hand: HandReading) -> str:
    if not hand.buttons <= set(BUTTONS):
        return "unknown button"
    if not hand.is_tracked:
        return ""
    for numbers, count in ((hand.pose, 7), (hand.twist, 6), (hand.joints, None)):
        if numbers is not None and not _is_vector(numbers, count):
            return "not finite"
    if hand.opening is not None and not -1e-6 <= hand.opening <= 1.0 + 1e-6:
        return "wrong opening"
    if hand.pose is not None and abs(float(np.linalg.norm(hand.pose[3:])) - 1.0) > 1e-3:
        return "no rotation"
    return ""


def _is_vector(numbers: NDArray[np.float64], count: int | None) -> bool:
    shape = np.shape(numbers)
    return len(shape) == 1 and count in (None, shape[0]) and bool(np.isfinite(numbers).all())


def _break_of(hand: HandReading, before: HandReading | None) -> str:
    """Return why a hand cannot be followed from the sample before; empty if it can."""
    if not hand.is_tracked:
        return "not tracked"
    if before is not None and before.is_tracked and hand.pose is not None and before.pose is not None:
        way = float(np.linalg.norm(hand.pose[:3] - before.pose[:3]))
        if way > LEAP:
            return f"leapt by {way:.2f} m"
    if before is not None and hand.joints is not None and before.joints is not None:
        turns = np.abs(hand.joints - before.joints) if hand.joints.shape == before.joints.shape else np.full(1, np.inf)
        if turns.max(initial=0.0) > JOINT_LEAP:
            return f"joint {int(turns.argmax()) + 1} leapt by {turns.max():.2f} rad"
    return ""
