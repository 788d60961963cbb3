"""Modes and controls that a camera of Linux (V4L2) offers, and how they are set, by the kernel's own calls.

Numbers and layouts are those of `linux/videodev2.h` and `linux/v4l2-controls.h`.
"""

from __future__ import annotations

import errno
import fcntl
import math
import struct
from collections.abc import Iterator
from typing import Any

from rcs.errors import DeviceFault, InvalidSetup

_QUERY, _GET, _SET = 0xC0445624, 0xC008561B, 0xC008561C
_SIZES, _INTERVALS = 0xC02C564A, 0xC034564B
_DISCRETE = 1
_CAMERA, _USER = 0x009A0900, 0x00980900
CONTROLS = ("exposure", "gain", "white_balance", "power_line_frequency", "lights")
"""Controls that a site may set: exposure [s], gain, white balance [K], power line frequency (0, 50 or 60 Hz); `lights`
are those of a DIGIT. Each that is not given is left to the camera, which adjusts it by itself."""
_IDS = {
    "exposure": _CAMERA + 2,
    "gain": _USER + 19,
    "white_balance": _USER + 26,
    "power_line_frequency": _USER + 24,
    "lights": _CAMERA + 13,  # the zoom, which a DIGIT uses for its lights
}
_AUTOMATIC = {"exposure": (_CAMERA + 1, (1,), (3, 0)), "white_balance": (_USER + 12, (0,), (1,))}
"""The control that switches to the camera's own choice, with values for off and on; the first that it takes counts."""
_LINE = {0: 0, 50: 1, 60: 2}


def modes(file: int, fourcc: str) -> list[tuple[int, int, list[float]]]:
    """Return width, height [px] and rates [1/s] that a camera offers in a format.

    Args:
        file: Its open file.
        fourcc: The format, such as `MJPG`.
    """
    code = int.from_bytes(fourcc.encode(), "little")
    found: list[tuple[int, int, list[float]]] = []
    for kind, width, height in _enumerated(file, _SIZES, "<11I", (code,), 2):
        if kind != _DISCRETE:
            continue
        rates = [
            below / above
            for is_discrete, above, below in _enumerated(file, _INTERVALS, "<13I", (code, width, height), 4)
            if is_discrete == _DISCRETE and above
        ]
        found.append((width, height, sorted(rates)))
    return found


def _enumerated(file: int, call: int, layout: str, start: tuple[int, ...], at: int) -> Iterator[tuple[int, int, int]]:
    size = struct.calcsize(layout) // 4
    for index in range(256):
        values = [index, *start]
        packet = bytearray(struct.pack(layout, *values, *[0] * (size - len(values))))
        try:
            fcntl.ioctl(file, call, packet)
        except OSError as err:
            if err.errno == errno.EINVAL:  # there are no more
                return
            raise
        kind, first, second = struct.unpack(layout, packet)[at : at + 3]
        yield kind, first, second


def set_controls(file: int, name: str, wanted: dict[str, Any]) -> None:
    """Set controls and read them back.

    Args:
        file: Open file of the camera.
        name: Its name in messages.
        wanted: Values by name, of `CONTROLS`.

    Raises:
        InvalidSetup: The camera has no such control or always chooses it itself, or the value is out of its range.
        DeviceFault: The camera does not take the value, or keeps another one.
    """
    for control, (switch, off, on) in _AUTOMATIC.items():
        if _range(file, switch) is None:
            continue
        values = off if control in wanted else on
        if not any(_takes(file, switch, value) for value in values) and control in wanted:
            raise InvalidSetup(f"{name} always chooses its {control} itself; leave the option {control} out.")
    for control, value in wanted.items():
        known = _range(file, _IDS[control])
        if known is None:
            there = [one for one in CONTROLS if _range(file, _IDS[one]) is not None]
            raise InvalidSetup(f"{name} has no control {control!r}; it has {', '.join(there) or 'none'}.")
        low, high, step = known
        number = _number(control, value)
        if not low <= number <= high:
            scale = 1e-4 if control == "exposure" else 1
            raise InvalidSetup(f"{control} of {name} is {value!r}; valid is {low * scale:g} to {high * scale:g}.")
        try:
            _write(file, _IDS[control], number)
        except OSError as err:
            raise DeviceFault(f"{name} does not take {control} = {value!r}: {err.strerror}") from err
        tolerance = 0 if control == "power_line_frequency" else max(step, 1)
        if abs((kept := _read(file, _IDS[control])) - number) > tolerance:
            raise DeviceFault(f"{name} keeps {control} at {kept} when it is set to {number}")


def _number(control: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InvalidSetup(f"{control} is {value!r}; valid is a number.")
    if control == "exposure":
        return round(value * 1e4)  # the kernel counts 100 µs
    if control == "power_line_frequency":
        if value not in _LINE:
            raise InvalidSetup(f"power_line_frequency is {value!r} Hz; valid is 0 (off), 50 or 60.")
        return _LINE[int(value)]
    return round(value)


def _range(file: int, control: int) -> tuple[int, int, int] | None:
    """Return least, greatest value and step of a control; None if there is none."""
    packet = bytearray(struct.pack("<II32s4iI2I", control, 0, b"", 0, 0, 0, 0, 0, 0, 0))
    try:
        fcntl.ioctl(file, _QUERY, packet)
    except OSError:
        return None
    _, _, _, low, high, step, _, flags, _, _ = struct.unpack("<II32s4iI2I", packet)
    return None if flags & 1 else (low, high, step)  # 1: disabled


def _read(file: int, control: int) -> int:
    packet = bytearray(struct.pack("<Ii", control, 0))
    fcntl.ioctl(file, _GET, packet)
    return struct.unpack("<Ii", packet)[1]


def _write(file: int, control: int, value: int) -> None:
    fcntl.ioctl(file, _SET, bytearray(struct.pack("<Ii", control, value)))


def _takes(file: int, control: int, value: int) -> bool:
    """Set a control, and return False where its menu does not have the value."""
    try:
        _write(file, control, value)
    except OSError as err:
        if err.errno in (errno.EINVAL, errno.ERANGE):
            return False
        raise
    return True
