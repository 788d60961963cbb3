"""Keys of a keyboard or a pedal that is for the robot alone, read as events of the kernel (`/dev/input/event*`)."""

from __future__ import annotations

import struct
import time
from abc import abstractmethod
from pathlib import Path

from rcs_data.files.closing import Closing

from rcs.teleop.device_file import DeviceFile, line_of

EVENT = struct.Struct("@llHHi")
"""An event of linux/input.h: its time in two numbers, type, code and value."""
SYNCHRONISATION, KEY, DROPPED = 0, 1, 3
RELEASED, PRESSED, REPEATED = 0, 1, 2
A = 30
"""Code of a key that every device has on which one can type (KEY_A)."""
HIGHEST = 0x2FF
"""Largest code of a key (KEY_MAX)."""
MATCH = 'KERNEL=="event*", SUBSYSTEM=="input", ATTRS{{name}}=="{}"'

NAMES = {
    1: "escape", 12: "-", 13: "=", 14: "backspace", 16: "q", 17: "w", 18: "e", 19: "r", 20: "t", 21: "y", 22: "u",
    23: "i", 24: "o", 25: "p", 28: "enter", 30: "a", 31: "s", 32: "d", 33: "f", 34: "g", 35: "h", 36: "j", 37: "k",
    38: "l", 44: "z", 45: "x", 46: "c", 47: "v", 48: "b", 49: "n", 50: "m", 57: "space", 103: "up", 105: "left",
    106: "right", 108: "down",
}  # fmt: skip
"""Names of keys by their code (linux/input-event-codes.h), after their place on an American keyboard."""


class Keys(Closing):
    """Keys of a keyboard, wherever they are."""

    def __init__(self) -> None:
        """Know no key yet."""
        self.held: set[str] = set()
        """Keys that are held; those without a name of their own are their code."""
        self.pressed: list[str] = []
        """Keys pressed and not yet taken, oldest first."""
        self.damaged = 0
        """Number of messages that could not be used."""
        self.time = 0.0
        """Until when the keys are known [s, `time.monotonic()`]."""

    @abstractmethod
    def open(self) -> None:
        """Begin to listen; faults as in `InputDevice.open`."""

    @abstractmethod
    def wait(self, seconds: float) -> None:
        """Take in what is pressed and released within a time [s]; return at the first event."""


class InputEvents(Keys):
    """Keys held and pressed on a device that this program keeps to itself."""

    def __init__(self, path: str, what: str) -> None:
        """Remember where it is.

        Args:
            path: Such as `/dev/input/event5`.
            what: The device in messages.
        """
        super().__init__()
        self.path, self._what = path, what
        self._file: DeviceFile | None = None
        self._rest = b""

    def open(self) -> None:
        """Open the device; what is held now counts once it is pressed again.

        Raises:
            DeviceFault: It is not there, may not be opened, or is in use.
        """
        node = Path(self.path).resolve().name  # the path may be a link of /dev/input/by-id
        name = line_of(Path("/sys/class/input") / node / "device" / "name")
        self._rest, self.pressed, self.damaged = b"", [], 0
        self.held = set()
        self._file = DeviceFile(self.path, self._what, MATCH.format(name), alone=True)
        self.time = time.monotonic()

    def wait(self, seconds: float) -> None:
        """Take in what is pressed and released within a time [s]; return at the first event.

        Raises:
            DeviceFault: The device is gone.
        """
        assert self._file is not None, "it is open"
        self.feed(self._file.read(seconds))
        self.time = time.monotonic()

    def feed(self, data: bytes) -> None:
        """Take in events, in pieces of any size."""
        self._rest += data
        whole = len(self._rest) // EVENT.size * EVENT.size
        events, self._rest = self._rest[:whole], self._rest[whole:]
        for _, _, kind, code, value in EVENT.iter_unpack(events):
            if kind == SYNCHRONISATION and code == DROPPED:
                self.held.clear()  # releases may have been lost
            elif kind == KEY:
                self._key(code, value)

    def close(self) -> None:
        """Give the device back to all programs."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _key(self, code: int, value: int) -> None:
        name = NAMES.get(code, str(code))
        if code > HIGHEST or not RELEASED <= value <= REPEATED:
            self.damaged += 1
        elif value == RELEASED:
            self.held.discard(name)
        elif value == PRESSED:
            self.held.add(name)
            self.pressed.append(name)


def find(is_wanted: frozenset[tuple[str, str]]) -> dict[str, str]:
    """Return the names of connected devices by path, of each the part that types.

    Args:
        is_wanted: Their vendors and products, four lower-case hexadecimal digits each.
    """
    found: dict[str, str] = {}
    for entry in sorted(Path("/sys/class/input").glob("event*")):
        about = entry / "device"
        is_known = (line_of(about / "id" / "vendor"), line_of(about / "id" / "product")) in is_wanted
        if is_known and keys_of(entry.name) >> A & 1:  # others are its mouse and its media keys
            found[f"/dev/input/{entry.name}"] = line_of(about / "name")
    return found


def keys_of(node: str) -> int:
    """Return the keys that a device such as `event5` has, one bit for each code; 0 if that is not known."""
    words = line_of(Path("/sys/class/input") / node / "device" / "capabilities" / "key").split()
    return int("0" + "".join(word.zfill(16) for word in words), 16)
