"""Writes TFRecord files of `tf.train.Example` records without TensorFlow.

A record is its length (8 bytes, little-endian), the masked CRC-32C of these, the data and its masked CRC-32C.
An Example is a Protocol Buffers message: a map from names to lists of bytes, floats or integers.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from rcs_data.convert.crc32c import crc32c
from rcs_data.errors import InvalidSetup

Values = Sequence[bytes] | NDArray[np.float32] | NDArray[np.int64]
"""A value in an Example: byte strings, floats or integers."""

# TensorFlow refuses messages of 2 GiB and more.
_MESSAGE_BYTES = (1 << 31) - 1
_LENGTH_DELIMITED = 2


class ShardWriter:
    """Records in files of limited size, "name-train.tfrecord-00001-of-00004"; `close` gives them these names."""

    def __init__(self, folder: Path, stem: str, shard_bytes: int) -> None:
        """Start without a file.

        Args:
            folder: Where the files go.
            stem: The file name before the number.
            shard_bytes: Largest size of a file of several records [B].
        """
        self._folder = folder
        self._stem = stem
        self._shard_bytes = shard_bytes
        self._file: BinaryIO | None = None
        self.shard_lengths: list[int] = []
        self.data_bytes = 0

    def write(self, data: bytes) -> None:
        """Add a record.

        Raises:
            OSError: The disk fails.
        """
        if self._file is None or self._file.tell() + len(data) > self._shard_bytes:
            self._next_file()
        assert self._file is not None, "there is a file after _next_file"
        self._file.write(frame(data))
        self.shard_lengths[-1] += 1
        self.data_bytes += len(data)

    def close(self) -> None:
        """Complete the last file, and name all files now that their number is known.

        Raises:
            OSError: The disk fails.
        """
        if self._file is None:
            return
        self._file.close()
        self._file = None
        total = len(self.shard_lengths)
        for i in range(total):
            self._unnamed(i).rename(self._folder / f"{self._stem}-{i:05d}-of-{total:05d}")

    def _next_file(self) -> None:
        if self._file is not None:
            self._file.close()
        self._file = self._unnamed(len(self.shard_lengths)).open("wb")
        self.shard_lengths.append(0)

    def _unnamed(self, index: int) -> Path:
        return self._folder / f"{self._stem}-{index:05d}"


def frame(data: bytes) -> bytes:
    """Return the data as a record."""
    length = struct.pack("<Q", len(data))
    return b"".join((length, _masked(length), data, _masked(data)))


def encode_example(features: Mapping[str, Values]) -> bytes:
    """Return a `tf.train.Example` with these names, sorted.

    Args:
        features: Byte strings, float32 numbers or int64 numbers by name; arrays are taken row by row.

    Raises:
        InvalidSetup: It is larger than TensorFlow can read.
    """
    entries: list[bytes] = []
    for name in sorted(features):
        values = features[name]
        if not isinstance(values, np.ndarray):
            kind, payload = 1, b"".join(_field(1, value) for value in values)
        elif values.dtype == np.float32:
            kind, payload = 2, _field(1, np.ascontiguousarray(values, "<f4").tobytes())
        else:
            kind, payload = 3, _field(1, _varints(values))
        entries.append(_field(1, _field(1, name.encode()) + _field(2, _field(kind, payload))))
    data = _field(1, b"".join(entries))
    if len(data) > _MESSAGE_BYTES:
        raise InvalidSetup(
            f"An episode is {len(data) / 2**30:.1f} GiB, and TensorFlow reads records of less than 2 GiB. "
            "Trim or split it, or export fewer cameras."
        )
    return data


def _masked(data: bytes) -> bytes:
    # Rotated and shifted by a constant, so that data containing checksums are not a special case.
    crc = crc32c(data)
    return struct.pack("<I", (((crc >> 15) | (crc << 17)) + 0xA282EAD8) & 0xFFFFFFFF)


def _field(number: int, payload: bytes) -> bytes:
    return b"".join((_varint(number << 3 | _LENGTH_DELIMITED), _varint(len(payload)), payload))


def _varints(values: NDArray[Any]) -> bytes:
    flat = values.reshape(-1)
    if flat.size and flat.min() >= 0 and flat.max() < 128:
        return flat.astype(np.uint8).tobytes()
    return b"".join(_varint(int(value) & 0xFFFF_FFFF_FFFF_FFFF) for value in flat)


def _varint(value: int) -> bytes:
    """Return a varint: seven bits per byte, the lowest first; the highest bit means that more follow."""
    parts = bytearray()
    while value > 127:
        parts.append(value & 127 | 128)
        value >>= 7
    parts.append(value)
    return bytes(parts)
