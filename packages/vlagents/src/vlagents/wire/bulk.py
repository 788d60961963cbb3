"""msgpack whose large values of bytes, such as images, are views of the message, and in which all else is small.

Small values grow when they are read: an empty dictionary is one byte of a message and 64 of memory, and other threads
wait for Python's lock while a library reads them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from msgspec import msgpack

from vlagents.errors import BadMessage
from vlagents.wire.stream import LARGEST_HEADER

LARGE = 64 << 10
"""Values of at least so many bytes are not copied [bytes]."""
PLACE = 1
"""Code of the extension that stands for a large value; messages on a wire have no extensions."""
FIXED = {0xC0: 1, 0xC2: 1, 0xC3: 1, 0xCA: 5, 0xCB: 9, 0xCC: 2, 0xCD: 3, 0xCE: 5, 0xCF: 9, 0xD0: 2, 0xD1: 3, 0xD2: 5} | {
    0xD3: 9
}
"""Bytes of values whose first byte says how long they are: nil, booleans, numbers."""
COUNTED = {0xC4: 1, 0xC5: 2, 0xC6: 4, 0xD9: 1, 0xDA: 2, 0xDB: 4}
"""Bytes that say how many bytes follow: bin and str."""
NESTED = {0xDC: (2, 1), 0xDD: (4, 1), 0xDE: (2, 2), 0xDF: (4, 2)}
"""Bytes that say how many values follow, and how many each counts for: arrays and maps."""


def unpack(data: bytes | memoryview, hook: Callable[[dict[Any, Any]], Any], *, most: int = LARGEST_HEADER) -> Any:
    """Read a message.

    Args:
        data: The message. Large values of bytes are views of it.
        hook: Takes each dictionary, innermost first, and returns what it stands for.
        most: Most bytes of all that is no large value; a message of fewer than `LARGE` bytes is read anyway.

    Raises:
        BadMessage: It is no msgpack, or has more bytes than that.
    """
    small, large = (data, []) if len(data) < LARGE else _apart(memoryview(data), most)

    def put_back(code: int, index: memoryview) -> memoryview:
        if code != PLACE or not large:
            raise BadMessage(f"A message has an extension of code {code}; valid are none.")
        return large[int.from_bytes(index, "big")]

    try:
        return _revived(msgpack.decode(small, ext_hook=put_back), hook)
    except BadMessage:
        raise
    except Exception as error:  # whatever msgspec raises for other bytes
        raise BadMessage(f"This is no msgpack: {type(error).__name__}: {error}.") from error


def _revived(value: Any, hook: Callable[[dict[Any, Any]], Any]) -> Any:
    if isinstance(value, list):
        return [_revived(each, hook) for each in value]
    return hook({key: _revived(each, hook) for key, each in value.items()}) if isinstance(value, dict) else value


def _apart(data: memoryview, most: int) -> tuple[bytes, list[memoryview]]:
    """Return a message with an extension in the place of each large value, and these."""
    small: list[bytes | memoryview] = []
    large: list[memoryview] = []
    at, done, skipped, left, size = 0, 0, 0, 1, len(data)
    while left:
        if at >= size:
            raise BadMessage(f"A message of msgpack ends after {size} bytes, in the middle of a value.")
        if at - skipped > most:
            raise BadMessage(f"A message has more than {most} bytes of what is no array of {LARGE} bytes or more.")
        kind = data[at]
        left -= 1
        if kind <= 0x7F or kind >= 0xE0:
            at += 1
        elif kind <= 0x8F:
            at, left = at + 1, left + 2 * (kind & 15)
        elif kind <= 0x9F:
            at, left = at + 1, left + (kind & 15)
        elif kind <= 0xBF:
            at += 1 + (kind & 31)
        elif kind in FIXED:
            at += FIXED[kind]
        elif kind in COUNTED:
            behind = at + 1 + COUNTED[kind]
            end = behind + int.from_bytes(data[at + 1 : behind], "big")
            if kind == 0xC6 and end - behind >= LARGE:
                small += [data[done:at], b"\xd6", PLACE.to_bytes(1, "big"), len(large).to_bytes(4, "big")]
                large.append(data[behind:end])
                done, skipped = end, skipped + end - at
            at = end
        elif kind in NESTED:
            width, each = NESTED[kind]
            left += each * int.from_bytes(data[at + 1 : at + 1 + width], "big")
            at += 1 + width
        else:
            raise BadMessage(f"A message has a value that begins with {kind:#04x}; valid are none with extensions.")
    if at != size:
        raise BadMessage(f"A message of msgpack ends after {at} bytes; it has {size}.")
    return b"".join([*small, data[done:]]), large
