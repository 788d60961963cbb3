"""Foot pedals, which leave the hands free."""

from __future__ import annotations

from rcs.teleop.device import POLL, Button, Connected, HandReading, Reading
from rcs.teleop.device_file import one_of
from rcs.teleop.input_events import InputEvents, find

PEDALS = frozenset({("0c45", "7403"), ("0c45", "7404"), ("413d", "2107"), ("1a86", "e026"), ("3553", "b001")})
"""Vendors and products of PCsensor's foot switches, which most are (the list of the program `footswitch`)."""
MEANINGS: dict[str, Button] = {"b": "gripper", "c": "start"}
"""Meanings of the keys with which pedals with three switches are sold; any other key is the clutch."""
CLUTCH = "clutch"
"""Address of a pedal of which every key is the clutch: those with one switch are sold with the key b."""


class Pedal(Connected[InputEvents]):
    """One to three pedals: clutch, gripper, and beginning or end of a take."""

    what = "foot pedal"
    valid_for = 0.1
    has_takeover = False

    def __init__(self, address: str | None = None) -> None:
        """Remember where they are.

        Args:
            address: Path such as `/dev/input/event5`; None for the only one of a known kind, `clutch` for that one with
                every key as the clutch.
        """
        super().__init__()
        self._address = None if address == CLUTCH else address
        self._meanings: dict[str, Button] = {} if address == CLUTCH else MEANINGS

    def connect(self) -> InputEvents:
        """Open the device and keep its keys from all other programs; faults as in `InputDevice.open`."""
        missing = "Plug it in, or give the path of another kind: ls -l /dev/input/by-id"
        keys = InputEvents(self._address or one_of("foot pedal", find(PEDALS), missing), "foot pedal")
        keys.open()
        return keys

    def measure(self, connection: InputEvents) -> Reading:
        """Return what is held, at each change and at least every 0.05 s."""
        connection.wait(POLL / 2)
        held = connection.held.union(connection.pressed)
        connection.pressed = []
        hand = HandReading(buttons=frozenset(self._meanings.get(key, "clutch") for key in held))
        return Reading(time=connection.time, hands={"right": hand}, counts={"damaged": connection.damaged})
