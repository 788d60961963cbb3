"""TFRecord files of `tf.train.Example` records, written and read without TensorFlow.

A record is its length (8 bytes, little-endian), the masked CRC-32C of these, the data and its masked CRC-32C. An
Example is a Protocol Buffers message: a map from names to lists of bytes, floats or integers. Images go from and to
the disk one by one, so a record of 2 GiB takes little memory.
"""

from __future__ import annotations

import mmap
import struct
import tempfile
from collections.abc import Container, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import google_crc32c
import numpy as np
from numpy.typing import NDArray

from rcs_data.convert.protobuf import BYTES, field, fields, integers, varint, varints
from rcs_data.errors import CorruptEpisode, InvalidSetup

Values = Iterable[bytes] | NDArray[np.float32] | NDArray[np.int64]
"""A value in an Example: byte strings, floats or integers."""

# TensorFlow refuses messages of 2 GiB and more.
_MESSAGE_BYTES = (1 << 31) - 1
_PIECE = 1 << 20
_BYTES_LIST, _FLOAT_LIST, _INT64_LIST = 1, 2, 3
# Far more than a dataset has features.
_MOST_NAMES = 10_000
# What is kept in memory of a file that is read [B]; a multiple of the piece.
_MOST_RESIDENT = 1 << 25
# Memory for the numbers of one feature of one episode [B]; images are not numbers.
_MOST_NUMBERS = 1 << 28


class ShardWriter:
    """Records in files of limited size, "name-train.tfrecord-00001-of-00004"; `close` gives them these names."""

    def __init__(self, folder: Path, stem: str, shard_bytes: int) -> None:
        """Start without a file; none with several records is larger than `shard_bytes`."""
        self._folder, self._stem, self._shard_bytes = folder, stem, shard_bytes
        self._file: BinaryIO | None = None
        self.shard_lengths: list[int] = []
        self.data_bytes = 0

    def write(self, features: Mapping[str, Values]) -> None:
        """Add an Example with these names, sorted; arrays are taken row by row.

        Raises:
            InvalidSetup: It is larger than TensorFlow can read.
            OSError: The disk fails.
        """
        with tempfile.TemporaryFile(dir=self._folder) as spool:
            heads: list[tuple[bytes, int]] = []
            for name in sorted(features):
                kind, size = _spool(features[name], spool)
                list_start = _start(kind, size)
                feature_start = _start(2, len(list_start) + size)
                key = field(1, name)
                entry_start = _start(1, len(key) + len(feature_start) + len(list_start) + size)
                heads.append((entry_start + key + feature_start + list_start, size))
            length = sum(len(head) + size for head, size in heads)
            heads.insert(0, (_start(1, length), 0))
            length += len(heads[0][0])
            if length > _MESSAGE_BYTES:
                raise InvalidSetup(
                    f"An episode is {length / 2**30:.1f} GiB, and TensorFlow reads records of less than 2 GiB. "
                    "Trim or split it, or export fewer cameras."
                )
            self._write_record(length, heads, spool)

    def close(self) -> None:
        """Complete the last file, and name all files now that their number is known; OSError if the disk fails."""
        if self._file is None:
            return
        self._file.close()
        self._file = None
        total = len(self.shard_lengths)
        for i in range(total):
            self._unnamed(i).rename(self._folder / shard_name(self._stem, i, total))

    def _write_record(self, length: int, heads: list[tuple[bytes, int]], spool: BinaryIO) -> None:
        if self._file is None or self._file.tell() + length > self._shard_bytes:
            if self._file is not None:
                self._file.close()
            self._file = self._unnamed(len(self.shard_lengths)).open("wb")
            self.shard_lengths.append(0)
        size = struct.pack("<Q", length)
        self._file.write(size + _masked(google_crc32c.value(size)))
        spool.seek(0)
        crc = 0
        for head, rest in heads:
            piece = head
            while piece:
                crc = google_crc32c.extend(crc, piece)
                self._file.write(piece)
                piece = spool.read(min(rest, _PIECE))
                rest -= len(piece)
        self._file.write(_masked(crc))
        self.shard_lengths[-1] += 1
        self.data_bytes += length

    def _unnamed(self, index: int) -> Path:
        return self._folder / f"{self._stem}-{index:05d}"


def shard_name(stem: str, index: int, total: int) -> str:
    """Return the name of a file of records, such as "name-train.tfrecord-00001-of-00004"."""
    return f"{stem}-{index:05d}-of-{total:05d}"


@dataclass(frozen=True)
class StoredValues:
    """One feature of an Example as stored: a list of byte strings, floats or integers."""

    name: str
    """The feature's name, for messages."""
    kind: int
    """The number of the list's type in a `tf.train.Feature`."""
    data: memoryview
    """The list."""
    file: mmap.mmap
    """The file that it is a part of."""

    def strings(self) -> Iterator[memoryview]:
        """Yield the byte strings; CorruptEpisode if the list has something else."""
        if self.kind != _BYTES_LIST:
            raise CorruptEpisode(f"{self.name!r} has numbers; expected byte strings.")
        return self._strings()

    def _strings(self) -> Iterator[memoryview]:
        read = 0
        for _, value in fields(self.data):
            yield value
            read += len(value)
            if read > _MOST_RESIDENT:
                _forget(self.file)
                read = 0

    def numbers(self, most: int) -> NDArray[np.float32] | NDArray[np.int64]:
        """Return the numbers; CorruptEpisode if the list has something else, or more than `most`: they are not read."""
        if self.kind == _BYTES_LIST:
            raise CorruptEpisode(f"{self.name!r} has byte strings; expected numbers.")
        # Four bytes per float; an integer has at least one, and takes eight in memory.
        largest = min(most * (4 if self.kind == _FLOAT_LIST else 10), _MOST_NUMBERS) + 64
        if len(self.data) > largest:
            raise CorruptEpisode(f"{self.name!r} has {len(self.data)} bytes, more than its {most} numbers take.")
        # A list is stored as one field, or as one for each number.
        data = b"".join(value for _, value in fields(self.data))
        if self.kind == _INT64_LIST:
            return integers(data)
        if len(data) % 4:
            raise CorruptEpisode(f"{self.name!r} has {len(data)} bytes of floats, which are 4 bytes each.")
        return np.frombuffer(data, "<f4")


def read_examples(path: Path, wanted: Container[int] | None = None) -> Iterator[dict[str, StoredValues]]:
    """Yield the Examples in a file, or those `wanted` by number; values are parts of the file, read when they are used.

    Raises:
        CorruptEpisode: The file is missing or damaged.
    """
    try:
        size = path.stat().st_size if path.is_file() else 0
        if not size:
            raise CorruptEpisode(f"{path} is missing, empty or not a file.")
        with path.open("rb") as file:
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except OSError as err:
        raise CorruptEpisode(f"Cannot read {path}: {err.strerror or err}.") from err
    data = memoryview(mapped)
    at, number = 0, -1
    while at < size:
        number += 1
        head = bytes(data[at : at + 12])
        length = int.from_bytes(head[:8], "little")
        if len(head) < 12 or head[8:] != _masked(google_crc32c.value(head[:8])) or at + length + 16 > size:
            raise CorruptEpisode(f"{path} is damaged at byte {at}: no whole record begins there.")
        if wanted is not None and number not in wanted:
            at += length + 16
            continue
        record = data[at + 12 : at + 12 + length]
        crc = 0
        for start in range(0, length, _PIECE):
            crc = google_crc32c.extend(crc, bytes(record[start : start + _PIECE]))
            if start % _MOST_RESIDENT == 0:
                _forget(mapped)
        if bytes(data[at + 12 + length : at + 16 + length]) != _masked(crc):
            raise CorruptEpisode(f"{path} is damaged: the record at byte {at} is not what was written.")
        try:
            yield _example(record, mapped)
        except CorruptEpisode as err:
            raise CorruptEpisode(f"{path}, record at byte {at}: {err}") from err
        at += length + 16


def _example(data: memoryview, file: mmap.mmap) -> dict[str, StoredValues]:
    found: dict[str, StoredValues] = {}
    for features in _of(data, 1):
        for entry in _of(features, 1):
            parts = dict(fields(entry))
            try:
                name = bytes(parts[1]).decode()
            except (KeyError, UnicodeDecodeError) as err:
                raise CorruptEpisode("A feature of an Example has no name.") from err
            if len(found) >= _MOST_NAMES:
                raise CorruptEpisode(f"An Example has more than {_MOST_NAMES} features.")
            for kind, values in fields(parts.get(2, data[:0])):
                found[name] = StoredValues(name, kind, values, file)
    return found


def _forget(file: mmap.mmap) -> None:
    """Give back the memory of what was read; the pages come again when they are needed."""
    file.madvise(mmap.MADV_DONTNEED)


def _of(data: memoryview, number: int) -> Iterator[memoryview]:
    return (value for found, value in fields(data) if found == number)


def _spool(values: Values, spool: BinaryIO) -> tuple[int, int]:
    """Write a list to a file, and return the number of its type and its size."""
    before = spool.tell()
    if not isinstance(values, np.ndarray):
        kind = _BYTES_LIST
        spool.writelines(field(1, value) for value in values)
    elif values.dtype == np.float32:
        kind = _FLOAT_LIST
        spool.write(field(1, np.ascontiguousarray(values, "<f4").tobytes()))
    else:
        kind = _INT64_LIST
        spool.write(field(1, varints(values)))
    return kind, spool.tell() - before


def _start(number: int, length: int) -> bytes:
    """Return what comes before the bytes of a field."""
    return varint(number << 3 | BYTES) + varint(length)


def _masked(crc: int) -> bytes:
    # Rotated and shifted by a constant, so that data containing checksums are not a special case.
    return struct.pack("<I", (((crc >> 15) | (crc << 17)) + 0xA282EAD8) & 0xFFFFFFFF)
