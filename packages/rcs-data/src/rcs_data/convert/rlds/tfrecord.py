"""Files of `tf.train.Example` records, without TensorFlow: messages and checksums are those of the package `tfrecord`.

A record is its length (8 bytes, little-endian), the masked CRC-32C of these, the message and its masked CRC-32C. The
package's own reader does not compare checksums, and its writer orders a message differently in every process; so the
four parts of a record are put together and taken apart here.
"""

from __future__ import annotations

import importlib
from collections.abc import Container, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from rcs_data.errors import CorruptEpisode, InvalidSetup, package_of

Values = Iterable[bytes] | NDArray[np.float32] | NDArray[np.int64]
"""A value in an Example: byte strings, floats or integers."""
Stored = list[bytes] | NDArray[np.float32] | NDArray[np.int64]
"""A value as it is read, arrays with one axis."""

# TensorFlow refuses messages of 2 GiB and more.
_MESSAGE_BYTES = (1 << 31) - 1
_LENGTH_BYTES, _CHECKSUM_BYTES = 8, 4


def load_tfrecord() -> Any:
    """Return the package tfrecord; MissingDependency if it is not installed."""
    package_of("tfrecord.writer", "rlds", "RLDS needs tfrecord")
    return importlib.import_module("tfrecord")


class ShardWriter:
    """Records in files of limited size, "name-train.tfrecord-00001-of-00004"; `close` gives them these names."""

    def __init__(self, folder: Path, stem: str, shard_bytes: int) -> None:
        """Start without a file; none with several records is larger than `shard_bytes`.

        Raises:
            MissingDependency: The package tfrecord is not installed.
        """
        self._folder, self._stem, self._shard_bytes = folder, stem, shard_bytes
        self._tfrecord = load_tfrecord()
        self._file: BinaryIO | None = None
        self.shard_lengths: list[int] = []
        self.data_bytes = 0

    def write(self, features: Mapping[str, Values]) -> None:
        """Add an Example with these names; arrays are taken row by row.

        Raises:
            InvalidSetup: It is larger than TensorFlow can read.
            OSError: The disk fails.
        """
        example = self._tfrecord.example_pb2.Example()
        size = 0
        for name, given in features.items():
            feature = example.features.feature[name]
            if not isinstance(given, np.ndarray):
                values = list(given)
                feature.bytes_list.value.extend(values)
                size += sum(map(len, values))
            else:
                kind = feature.float_list if given.dtype == np.float32 else feature.int64_list
                kind.value.extend(given.reshape(-1).tolist())
                size += given.nbytes
        if size > _MESSAGE_BYTES:
            raise InvalidSetup(
                f"An episode is {size / 2**30:.1f} GiB, and TensorFlow reads records of less than 2 GiB. "
                "Trim or split it, or export fewer cameras."
            )
        self._write_record(example.SerializeToString(deterministic=True))

    def close(self) -> None:
        """Complete the last file, and name all files now that their number is known; OSError if the disk fails."""
        if self._file is None:
            return
        self._file.close()
        self._file = None
        total = len(self.shard_lengths)
        for i in range(total):
            self._unnamed(i).rename(self._folder / shard_name(self._stem, i, total))

    def _write_record(self, message: bytes) -> None:
        if self._file is None or self._file.tell() + len(message) > self._shard_bytes:
            if self._file is not None:
                self._file.close()
            self._file = self._unnamed(len(self.shard_lengths)).open("wb")
            self.shard_lengths.append(0)
        checksum = self._tfrecord.TFRecordWriter.masked_crc
        length = len(message).to_bytes(_LENGTH_BYTES, "little")
        self._file.writelines((length, checksum(length), message, checksum(message)))
        self.shard_lengths[-1] += 1
        self.data_bytes += len(message)

    def _unnamed(self, index: int) -> Path:
        return self._folder / f"{self._stem}-{index:05d}"


def shard_name(stem: str, index: int, total: int) -> str:
    """Return the name of a file of records, such as "name-train.tfrecord-00001-of-00004"."""
    return f"{stem}-{index:05d}-of-{total:05d}"


def read_examples(path: Path, wanted: Container[int] | None = None) -> Iterator[dict[str, Stored]]:
    """Yield the Examples in a file, or those `wanted` by number, as values by name.

    Raises:
        MissingDependency: The package tfrecord is not installed.
        CorruptEpisode: The file is missing or damaged.
    """
    tfrecord = load_tfrecord()
    decode_error = importlib.import_module("google.protobuf.message").DecodeError
    checksum = tfrecord.TFRecordWriter.masked_crc
    if not path.is_file() or not path.stat().st_size:
        raise CorruptEpisode(f"{path} is missing, empty or not a file.")
    try:
        with path.open("rb") as file:
            number, size = 0, path.stat().st_size
            while (start := file.tell()) < size:
                head = file.read(_LENGTH_BYTES + _CHECKSUM_BYTES)
                length = int.from_bytes(head[:_LENGTH_BYTES], "little")
                end = start + len(head) + length + _CHECKSUM_BYTES
                if checksum(head[:_LENGTH_BYTES]) != head[_LENGTH_BYTES:] or end > size:
                    raise CorruptEpisode(f"{path} is damaged at byte {start}: no whole record begins there.")
                if wanted is None or number in wanted:
                    message = file.read(length)
                    if checksum(message) != file.read(_CHECKSUM_BYTES):
                        raise CorruptEpisode(f"{path} is damaged: the record at byte {start} is not what was written.")
                    yield _values(tfrecord.example_pb2.Example.FromString(message))
                file.seek(end)
                number += 1
    except OSError as err:
        raise CorruptEpisode(f"Cannot read {path}: {err.strerror or err}.") from err
    except decode_error as err:
        raise CorruptEpisode(f"{path} has a record that is no Example: {err}.") from err


def _values(example: Any) -> dict[str, Stored]:
    found: dict[str, Stored] = {}
    for name, feature in example.features.feature.items():
        kind = feature.WhichOneof("kind")
        if kind == "bytes_list":
            found[name] = list(feature.bytes_list.value)
        elif kind == "float_list":
            found[name] = np.array(feature.float_list.value, np.float32)
        elif kind == "int64_list":
            found[name] = np.array(feature.int64_list.value, np.int64)
    return found
