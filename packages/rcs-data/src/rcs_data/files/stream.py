"""The rows of an open episode on disk: an Arrow IPC stream that can only grow.

A killed writer leaves a stream that is readable up to its last whole batch. A Parquet file would be lost, since its
footer is written last.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa

from rcs_data.errors import CorruptEpisode
from rcs_data.files.durable import disk_errors, write_all

_HEADER = b"rcs"


class EpisodeHeader(msgspec.Struct, frozen=True, kw_only=True):
    """What is known of an episode before its first row, stored in the stream's header."""

    id: str
    """The name of the episode."""
    seed: int | None
    """The seed of the reset."""
    instruction: str
    """What the robot is asked to do."""
    started: str
    """Wall clock at the start, ISO 8601 in UTC."""
    versions: dict[str, str]
    """Versions of the recording software."""


_DECODER = msgspec.json.Decoder(EpisodeHeader)


class StreamWriter:
    """Appends batches to a stream; each is passed to the operating system in one call and then survives a kill."""

    def __init__(self, path: Path, schema: pa.Schema, header: EpisodeHeader) -> None:
        """Create the file with its header.

        Raises:
            DatasetError: The file cannot be made.
        """
        self._path = path
        self._size = 0
        with disk_errors("start an episode", path):
            self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
            try:
                self._append(schema.with_metadata({_HEADER: msgspec.json.encode(header)}).serialize())
            except BaseException:
                os.close(self._fd)
                raise
        self._closed = False

    def write(self, batch: pa.RecordBatch) -> None:
        """Append a batch.

        Raises:
            DatasetError: The disk is full or fails; earlier batches stay readable.
        """
        with disk_errors("record rows", self._path, keeps_rows=True):
            self._append(batch.serialize())

    def close(self) -> None:
        """Close the file; calling it twice is harmless."""
        if not self._closed:
            self._closed = True
            os.close(self._fd)

    def _append(self, message: pa.Buffer) -> None:
        try:
            write_all(self._fd, memoryview(message))
        except OSError:
            # Half a batch at the end would be skipped on reading; without it the stream is whole.
            os.ftruncate(self._fd, self._size)
            raise
        self._size += message.size


class StreamReader:
    """The readable part of a stream.

    Attributes:
        header: What was known of the episode at its start; None if the header is torn, and then there are no rows.
        schema: The columns; None if the header is torn.
        is_torn: Whether unreadable data follow the last batch; known once the batches were read.
    """

    def __init__(self, path: Path) -> None:
        """Open a stream.

        Raises:
            DatasetError: The file cannot be read.
        """
        self.header: EpisodeHeader | None = None
        self.schema: pa.Schema | None = None
        self.is_torn = False
        self._reader: Any = None
        with disk_errors("read the rows of an open episode", path):
            if path.stat().st_size == 0:
                return
            if not path.is_file():
                raise CorruptEpisode(f"{path} is not a file.")
            source = pa.OSFile(str(path))  # not mapped: what was read would count as memory
        try:
            self._reader = pa.ipc.open_stream(source)
            schema = self._reader.schema
            self.header = _DECODER.decode((schema.metadata or {}).get(_HEADER, b""))
            self.schema = schema.remove_metadata()
        except (pa.ArrowException, OSError, ValueError, msgspec.MsgspecError):
            self._reader = None
            self.is_torn = True

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Yield the batches before the end or the first incomplete one."""
        while self._reader is not None:
            try:
                batch = self._reader.read_next_batch()
                batch.validate(full=True)
            except StopIteration:
                return
            except (pa.ArrowException, OSError):
                self.is_torn = True
                return
            yield batch
