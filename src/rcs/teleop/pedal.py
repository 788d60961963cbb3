"""Foot pedals, which leave the hands free."""

from __future__ import annotations

from rcs.teleop.device import POLL, Button, HandReading, InputDevice, Opened, Reading
from rcs.teleop.device_file import one_of
from rcs.teleop.input_events import InputEvents, find

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
