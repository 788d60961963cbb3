"""A SpaceMouse of 3Dconnexion: a knob with six axes that commands velocities, read from the kernel's raw HID files."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rcs.teleop.device import POLL, Button, Connected, HandReading, Motion, Reading
from rcs.teleop.device_file import DeviceFile, line_of, one_of

VENDORS = ("0000256F", "0000046D")
"""3Dconnexion, and Logitech, which sold older models, as in the kernel's HID_ID."""
MULTI_AXIS = b"\x05\x01\x09\x08"
"""First bytes of the report descriptor of a multi-axis controller: usage page 1, usage 8 (HID usage tables)."""
MATCH = 'KERNEL=="hidraw*", KERNELS=="*:256F:*|*:046D:C6[02]*"'
FULL = 350.0
"""Counts of a full deflection (logical maximum in the report descriptors)."""
MOST = 2.0
"""Share of a full deflection above which a report is damaged."""
SPEED = 0.25
"""Velocity at full deflection [m/s]."""
TURN_SPEED = 1.0
"""Rotational velocity at full deflection [rad/s]."""
DEFLECTED = 0.08
"""Share of a full deflection from which the knob counts as deflected."""
FIRST, ROTATION, KEYS = 1, 2, 3
"""Numbers of reports."""
MEANINGS: dict[int, Button] = {
    0: "gripper", 1: "start", 12: "success", 13: "failure", 14: "discard", 15: "reset", 22: "stop",
}  # fmt: skip
"""Meanings by bit: left and right of the small models; 1 to 4 and Esc of the Pro ones."""
TO_FRONT_LEFT_UP = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""The knob's axes point to the right, to the person and down."""


class KnobReports:
    """Decodes reports; what they say last is kept."""

    def __init__(self) -> None:
        """Begin with the knob at rest."""
        self.axes = np.zeros(6)
        """Deflection to the right, to the person, down, and about these axes; 1 is full."""
        self.keys = 0
        """Bits of the buttons that are held."""
        self.damaged = 0
        """Number of reports that could not be used."""

    def feed(self, report: bytes) -> bool:
        """Take in one report with its number first; return True if it was of use."""
        number, values = (report[0], report[1:]) if report else (-1, b"")
        if number == FIRST and len(values) in (6, 12):  # newer models send all six axes
            return self._set(slice(0, len(values) // 2), values)
        if number == ROTATION and len(values) == 6:
            return self._set(slice(3, 6), values)
        if number == KEYS and 1 <= len(values) <= 8:
            self.keys = int.from_bytes(values, "little")
            return True
        if number in (0, FIRST, ROTATION, KEYS):  # others are the battery's and the like
            self.damaged += 1
        return False

    def _set(self, which: slice, values: bytes) -> bool:
        shares = np.frombuffer(values, "<i2") / FULL
        if (np.abs(shares) > MOST).any():
            self.damaged += 1
            return False
        self.axes[which] = np.clip(shares, -1.0, 1.0)
        return True

    @property
    def is_deflected(self) -> bool:
        """True if the knob is off its rest."""
        return bool((np.abs(self.axes) > DEFLECTED).any())

    @property
    def twist(self) -> NDArray[np.float64]:
        """Velocity to the front, left and up [m/s], and about these axes [rad/s], (6,)."""
        return np.concatenate([
            SPEED * TO_FRONT_LEFT_UP @ self.axes[:3], TURN_SPEED * TO_FRONT_LEFT_UP @ self.axes[3:]
        ])  # fmt: skip


class SpaceMouse(Connected[DeviceFile]):
    """A SpaceMouse, connected by cable or wirelessly."""

    what = "SpaceMouse"
    valid_for = 0.1
    has_takeover = False
    motion: Motion = ("twist", 6)

    def __init__(self, address: str | None = None) -> None:
        """Remember where it is.

        Args:
            address: Path such as `/dev/hidraw3`; None for the only one.
        """
        super().__init__()
        self._address = address
        self._reports = KnobReports()

    def connect(self) -> DeviceFile:
        """Open its file; faults as in `InputDevice.open`."""
        path = self._address or one_of("SpaceMouse", find(), "Plug it in, or give the path of its file /dev/hidraw….")
        self._reports = KnobReports()
        return DeviceFile(path, "SpaceMouse", MATCH)

    def measure(self, connection: DeviceFile) -> Reading | None:
        """Return a reading at each report, and while the knob is at rest; None if it is deflected and silent."""
        reports = self._reports
        report = connection.read(POLL / 2)  # the kernel gives one report per read
        is_new = bool(report) and reports.feed(report)
        # A deflected knob reports without a pause, one at rest, which may be a little off zero, not at all.
        if not is_new and reports.is_deflected:
            return None
        buttons: set[Button] = {meaning for bit, meaning in MEANINGS.items() if reports.keys >> bit & 1}
        if reports.is_deflected:
            buttons.add("clutch")
        twist = reports.twist if is_new or reports.is_deflected else np.zeros(6)
        hand = HandReading(twist=twist, buttons=frozenset(buttons))
        return Reading(time=time.monotonic(), hands={"right": hand}, counts={"damaged": reports.damaged})


def find() -> dict[str, str]:
    """Return the names of all connected SpaceMouses by the path of their files."""
    found: dict[str, str] = {}
    for entry in sorted(Path("/sys/class/hidraw").glob("hidraw*")):
        lines = line_of(entry / "device" / "uevent").splitlines()
        about = {line.partition("=")[0]: line.partition("=")[2] for line in lines}
        vendor = about.get("HID_ID", "::").split(":")[1]
        try:
            is_knob = (entry / "device" / "report_descriptor").read_bytes().startswith(MULTI_AXIS)
        except OSError:
            is_knob = False
        if vendor in VENDORS and is_knob:
            found[f"/dev/{entry.name}"] = about.get("HID_NAME", "without a name")
    return found
