"""Foot pedals, which leave the hands free, and the buttons of a pedal or a keyboard beside another device."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from rcs.envs.spaces import Observation
from rcs.teleop.device import OF_HANDS, POLL, Button, HandReading, InputDevice, Reading
from rcs.teleop.device_file import one_of
from rcs.teleop.feed import Feed
from rcs.teleop.input_events import InputEvents, find
from rcs.teleop.opened import Opened

PEDALS = frozenset({("0c45", "7403"), ("0c45", "7404"), ("413d", "2107"), ("1a86", "e026"), ("3553", "b001")})
"""Vendors and products of PCsensor's foot switches, which most are (the list of the program `footswitch`)."""
MEANINGS: dict[str, Button] = {"b": "gripper", "c": "start"}
"""Meanings of the keys with which pedals with three switches are sold; any other key is the clutch."""
CLUTCH = "clutch"
"""Address of a pedal of which every key is the clutch: those with one switch are sold with the key b."""


class Pedal(InputDevice):
    """One to three pedals: clutch, gripper, and beginning or end of a take."""

    valid_for = 0.1
    has_takeover = False

    def __init__(self, address: str | None = None) -> None:
        """Remember where they are.

        Args:
            address: Path such as `/dev/input/event5`; None for the only one of a known kind, `clutch` for that one with
                every key as the clutch.
        """
        self._address = None if address == CLUTCH else address
        self._meanings: dict[str, Button] = {} if address == CLUTCH else MEANINGS
        self._opened = Opened[InputEvents]("foot pedal")

    def open(self) -> None:
        """Open the device and keep its keys from all other programs; faults as in `InputDevice.open`."""
        missing = "Plug it in, or give the path of another kind: ls -l /dev/input/by-id"
        keys = InputEvents(self._address or one_of("foot pedal", find(PEDALS), missing), "foot pedal")
        keys.open()
        self._opened.put(keys)

    def read(self) -> Reading | None:
        """Return what is held, at each change and at least every 0.05 s."""
        with self._opened as keys:
            keys.wait(POLL / 2)
            held = keys.held.union(keys.pressed)
            keys.pressed = []
            buttons: frozenset[Button] = frozenset(self._meanings.get(key, "clutch") for key in held)
            return Reading(
                time=keys.time, hands={"right": HandReading(buttons=buttons)}, counts={"damaged": keys.damaged}
            )

    def close(self) -> None:
        """Give the device back."""
        self._opened.close()


class WithButtons(InputDevice):
    """A device that leads, with the buttons of a second one beside it, such as a pedal, or a keyboard to judge takes.

    Clutch, gripper and front of the second count for all hands. When it is silent they are released, and what is held
    when it is back counts once it is pressed again. Its requests count also while the first is silent or lost.
    """

    def __init__(self, device: InputDevice, buttons: InputDevice, *, clutch: bool | None = None) -> None:
        """Take both; nothing is connected.

        Args:
            device: The device that leads.
            buttons: The device whose buttons count, and nothing else.
            clutch: Whether the clutch is that of the second device alone; None if that is a pedal. The clutch of a
                keyboard is any key of motion.
        """
        self._device, self._second = device, Feed(buttons)
        self._clutch = isinstance(buttons, Pedal) if clutch is None else clutch
        self.valid_for, self.hands, self.has_clutch = device.valid_for, device.hands, self._clutch or device.has_clutch
        self.has_takeover, self.motion = device.has_takeover or buttons.has_takeover, device.motion
        self._lock = threading.Lock()
        self._held: frozenset[Button] = frozenset()
        """Buttons of hands that are held and count."""
        self._tapped: frozenset[Button] = frozenset()
        """Buttons of hands that were pressed since the last reading; some are released again."""
        self._off: frozenset[Button] = OF_HANDS
        """Buttons that have to be released before they count."""
        self._requests: list[Button] = []

    def open(self) -> None:
        """Open both; faults as in `InputDevice.open`."""
        self._second.open()
        try:
            self._device.open()
        except BaseException:
            self._second.close()
            raise
        self.instructions = "\n".join(filter(None, (self._device.instructions, self._second.device.instructions)))

    def read(self) -> Reading | None:
        """Return the next reading of the first device, with the buttons of the second."""
        reading = self._device.read()
        if reading is None:
            return None
        with self._lock:
            self._listen()
            own, self._tapped = self._held | self._tapped, frozenset()
        other: set[Button] = {"clutch"} if self._clutch else set()
        hands = {name: replace(hand, buttons=hand.buttons - other | own) for name, hand in reading.hands.items()}
        return replace(reading, hands=hands, counts=self._second.left_out + Counter(reading.counts))

    def reopen(self) -> None:
        """Open the first device again; the second stays open, and is opened again by itself when it is lost."""
        self._device.reopen()

    def requests(self) -> Sequence[Button]:
        """Return the requests made at the second device since the last call, oldest first."""
        earlier = self._device.requests()
        with self._lock:
            self._listen()
            requests, self._requests = self._requests, []
        return [*earlier, *requests]

    def _listen(self) -> None:
        """Take in what has happened at the second device."""
        news = self._second.poll()
        pressed: list[Button] = [button for of_hand in news.pressed.values() for button in of_hand]
        self._requests.extend(news.requests)
        self._requests.extend(button for button in pressed if button not in OF_HANDS)
        if news.reading is None:
            self._held, self._tapped, self._off = frozenset(), frozenset(), OF_HANDS
            return
        counting = OF_HANDS if self._clutch else OF_HANDS - {"clutch"}
        tapped = counting.intersection(pressed)
        held = counting.intersection(button for hand in news.reading.hands.values() for button in hand.buttons)
        self._off &= held - tapped
        self._held, self._tapped = held - self._off, self._tapped | tapped

    def feedback(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Show both what the robot does."""
        self._device.feedback(observation, info)
        self._second.device.feedback(observation, info)

    def close(self) -> None:
        """Close both. Closing twice is harmless."""
        try:
            self._device.close()
        finally:
            self._second.close()
