"""Protocol Buffers messages, written and read field by field, as far as TFRecord and MCAP files need them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.errors import CorruptEpisode

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5
"""Wire types: how a field's value is stored."""

# A varint holds 64 bits, seven in each byte.
_LONGEST_VARINT = 10


def varint(value: int) -> bytes:
    """Return a number from 0 to 2 ** 64 - 1 as a varint: seven bits per byte, the lowest first."""
    parts = bytearray()
    while value > 127:
        parts.append(value & 127 | 128)
        value >>= 7
    parts.append(value)
    return bytes(parts)


def field(number: int, value: bytes | str | int, wire: int | None = None) -> bytes:
    """Return one field of a message: a whole number from 0, or bytes, text or an encoded message after its length.

    Args:
        number: Its number.
        value: The value.
        wire: The wire type of bytes that are stored without their length.
    """
    if isinstance(value, int):
        return varint(number << 3 | VARINT) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    if wire is not None:
        return varint(number << 3 | wire) + data
    return b"".join((varint(number << 3 | BYTES), varint(len(data)), data))


def fields(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield number and value of each field of a message, in order; a value is a part of the data.

    Raises:
        CorruptEpisode: It is not a message.
    """
    at = 0
    while at < len(data):
        tag, at = _read_varint(data, at)
        wire = tag & 7
        if wire == BYTES:
            length, at = _read_varint(data, at)
        elif wire == VARINT:
            length = _read_varint(data, at)[1] - at
        elif wire in (FIXED64, FIXED32):
            length = 8 if wire == FIXED64 else 4
        else:
            raise CorruptEpisode(f"A message has a field of wire type {wire}.")
        if at + length > len(data):
            raise CorruptEpisode(f"A field of a message claims {length} bytes, but only {len(data) - at} follow.")
        yield tag >> 3, data[at : at + length]
        at += length


def varints(values: NDArray[Any]) -> bytes:
    """Return whole numbers as varints one after the other, row by row."""
    flat = values.reshape(-1)
    if flat.size and flat.min() >= 0 and flat.max() < 128:
        return flat.astype(np.uint8).tobytes()
    return b"".join(varint(int(value) & 0xFFFF_FFFF_FFFF_FFFF) for value in flat)


def integers(data: bytes | memoryview) -> NDArray[np.int64]:
    """Return the numbers in varints one after the other.

    Raises:
        CorruptEpisode: One of them is too long, or the last ends too early.
    """
    raw = np.frombuffer(data, np.uint8)
    ends = np.flatnonzero(raw < 128)
    if ends.size == raw.size:
        return raw.astype(np.int64)
    if not ends.size or ends[-1] != raw.size - 1:
        raise CorruptEpisode("The last number of a list ends too early.")
    starts = np.concatenate([[0], ends[:-1] + 1])
    lengths = ends - starts + 1
    if lengths.max() > _LONGEST_VARINT:
        raise CorruptEpisode(f"A number in a list has {lengths.max()} bytes; at most {_LONGEST_VARINT} are valid.")
    shifts = 7 * (np.arange(raw.size) - np.repeat(starts, lengths))
    parts = (raw & 127).astype(np.uint64) << shifts.astype(np.uint64)
    return np.bitwise_or.reduceat(parts, starts).view(np.int64)


def _read_varint(data: memoryview, at: int) -> tuple[int, int]:
    """Return the number at a place, and where it ends."""
    value = 0
    for index, byte in enumerate(data[at : at + _LONGEST_VARINT]):
        value |= (byte & 127) << 7 * index
        if byte < 128:
            return value, at + index + 1
    raise CorruptEpisode("A message ends within a number, or a number in it is too long.")
