"""The rows of an open episode on disk: an Arrow IPC stream that can only grow.

A killed writer leaves a stream that is readable up to its last whole batch. A Parquet file would be lost, since its
footer is written last.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa

from rcs_data.about import MOST_SEED
from rcs_data.durable import disk_errors, write_all
from rcs_data.errors import CorruptEpisode
from rcs_data.text import mended_text

_HEADER = b"rcs"


@dataclass(frozen=True, kw_only=True)
class EpisodeHeader:
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

    def to_metadata(self) -> dict[bytes, bytes]:
        """Return the header as the metadata of an Arrow schema."""
        return {_HEADER: json.dumps(vars(self)).encode()}

    @classmethod
    def from_metadata(cls, metadata: dict[bytes, bytes]) -> EpisodeHeader:
        """Build the header from what `to_metadata` returned.

        Invalid text, which older versions allowed, is replaced, so that the rows are not lost.

        Raises:
            ValueError: The metadata has no header, or an invalid one.
        """
        given = json.loads(mended_text(json.dumps(json.loads(metadata.get(_HEADER, b"{}")), ensure_ascii=False)))
        try:
            header = cls(**given)
        except TypeError as err:
            raise ValueError(f"not a header of an episode: {err!r}") from err
        texts = [header.id, header.instruction, header.started]
        has_seed = header.seed is None or (type(header.seed) is int and abs(header.seed) < MOST_SEED)
        if not (has_seed and isinstance(header.versions, dict)):
            raise ValueError(f"not a header of an episode: {given!r:.200}")
        if not all(isinstance(text, str) for text in [*texts, *header.versions.values()]):
            raise ValueError(f"not a header of an episode: {given!r:.200}")
        return header


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
                self._append(schema.with_metadata(header.to_metadata()).serialize())
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
            self.header = EpisodeHeader.from_metadata(schema.metadata or {})
            self.schema = schema.remove_metadata()
        except (pa.ArrowException, OSError, ValueError, RecursionError):
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
