"""The rows of an open episode on disk: an Arrow IPC stream that can only grow.

A killed writer leaves a stream that is readable up to its last whole batch. A Parquet file would be lost, since its
footer is written last. Beside the stream, a file has the size and the CRC-32 of the header and of each batch, written
after them: they distinguish what was cut short from what was changed.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa

from rcs_data.errors import CorruptEpisode
from rcs_data.files.durable import disk_errors, write_all
from rcs_data.files.layout import CHECKSUMS_FILE

_HEADER = b"rcs"
_NEW_FILE = os.O_WRONLY | os.O_CREAT | os.O_EXCL
_CHECKSUM = struct.Struct("<II")  # size and CRC-32


class EpisodeHeader(msgspec.Struct, frozen=True, kw_only=True):
    """Facts that are known of an episode before its first row, stored in the stream's header."""

    id: str
    """The name of the episode."""
    seed: int | None
    """The seed of the reset."""
    instruction: str
    """The instruction to the robot."""
    started: str
    """Wall clock at the start, ISO 8601 in UTC."""
    versions: dict[str, str]
    """Versions of the recording software."""


_DECODER = msgspec.json.Decoder(EpisodeHeader)


class StreamWriter:
    """Appends batches to a stream; each is passed to the operating system in one call and then survives a kill."""

    def __init__(self, path: Path, schema: pa.Schema, header: EpisodeHeader) -> None:
        """Create the file with its header, and that of the checksums.

        Raises:
            DatasetError: A file cannot be made.
        """
        self._path = path
        self._size = 0
        self._fds: list[int] = []
        with disk_errors("start an episode", path):
            try:
                for file in (path.with_name(CHECKSUMS_FILE), path):
                    self._fds.append(os.open(file, _NEW_FILE, 0o644))
                self._append(schema.with_metadata({_HEADER: msgspec.json.encode(header)}).serialize())
            except BaseException:
                self.close()
                raise

    def write(self, batch: pa.RecordBatch) -> None:
        """Append a batch.

        Raises:
            DatasetError: The disk is full or fails; earlier batches stay readable.
        """
        with disk_errors("record rows", self._path, keeps_rows=True):
            self._append(batch.serialize())

    def close(self) -> None:
        """Close the files; calling it twice is harmless."""
        while self._fds:
            os.close(self._fds.pop())

    def _append(self, message: pa.Buffer) -> None:
        checksums, rows = self._fds
        try:
            write_all(rows, memoryview(message))
            write_all(checksums, _CHECKSUM.pack(message.size, zlib.crc32(message)))
        except OSError:
            # Half a batch at the end would be skipped on reading; without it the stream is whole.
            os.ftruncate(rows, self._size)
            raise
        self._size += message.size


class StreamReader:
    """The readable part of a stream.

    Attributes:
        header: The facts that were known of the episode at its start; None if that cannot be read, and then no rows
            can.
        schema: The columns; None likewise.
        is_torn: Whether unreadable data follow the last batch; known once the batches were read.
    """

    def __init__(self, path: Path) -> None:
        """Open a stream.

        Raises:
            DatasetError: The file cannot be read.
            CorruptEpisode: The header is not what was written.
        """
        self.header: EpisodeHeader | None = None
        self.schema: pa.Schema | None = None
        self.is_torn = False
        self._path = path
        self._reader: Any = None
        with disk_errors("read the rows of an open episode", path):
            self._size = path.stat().st_size
            self._checksums = _checksums(path.with_name(CHECKSUMS_FILE))
            if self._size == 0:
                return
            if not path.is_file():
                raise CorruptEpisode(f"{path} is not a file.")
            self._source = pa.OSFile(str(path))  # not mapped: what was read would count as memory
        self._compare(0, 0)
        try:
            self._reader = pa.ipc.open_stream(self._source)
            schema = self._reader.schema
            self.header = _DECODER.decode((schema.metadata or {}).get(_HEADER, b""))
            self.schema = schema.remove_metadata()
        except (pa.ArrowException, OSError, ValueError, msgspec.MsgspecError):
            self._reader = None
            self.is_torn = True

    @property
    def may_hide_rows(self) -> bool:
        """Whether there may be rows in a stream without a readable batch: more than a kill leaves of the first one."""
        if self._size == 0 or self._checksums is None:
            return self._size > 0
        return len(self._checksums) > 1 and self._size > self._checksums[0][0]

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Yield the batches before the end or the first incomplete one; a last one that is damaged counts as that.

        Raises:
            CorruptEpisode: A batch before the last is not what was written.
        """
        number = 0
        while self._reader is not None:
            number += 1
            place = self._source.tell()
            try:
                self._compare(number, place)
                batch = self._reader.read_next_batch()
                batch.validate(full=True)
            except (StopIteration, pa.ArrowException, OSError):
                self.is_torn = place < self._size  # zeros, too, are read as the end
                return
            yield batch

    def _compare(self, number: int, place: int) -> None:
        """Compare what comes next, the header as number 0 or a batch, with its checksum, unless it is cut short."""
        if self._checksums is None or number >= len(self._checksums):  # a kill prevented its writing
            return
        size, checksum = self._checksums[number]
        if place + size > self._size:
            return
        data = self._source.read(size)
        self._source.seek(place)
        if zlib.crc32(data) == checksum:
            return
        if number > 1 and number == len(self._checksums) - 1 and place + size == self._size:
            raise OSError("the last batch is damaged, as a loss of power leaves it")
        what = f"batch {number}" if number else "the header"
        raise CorruptEpisode(
            f"{self._path} is damaged: {what} is not what was written; it is left alone. `rcs data check --repair` "
            "puts it aside."
        )


def _checksums(path: Path) -> list[tuple[int, int]] | None:
    """Return the size and CRC-32 of the header and of each batch; None if the file is gone."""
    if not path.is_file():
        return None
    data = path.read_bytes()
    return [*_CHECKSUM.iter_unpack(data[: len(data) // _CHECKSUM.size * _CHECKSUM.size])]
