"""Single images of an episode in any order, without reading those around them.

Parquet returns a column in chunks of hundreds of rows. But images are stored in it uncompressed, so it is enough to
know where each begins. The places are found by reading a column once, verifying its checksums, and looking for each
image in the file; an image that is not found, as in files of other writers, is kept in memory.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data import parquet
from rcs_data.cache import ByteCache
from rcs_data.codec import decode_frame, pixel_buffer
from rcs_data.errors import CorruptEpisode, InvalidSetup
from rcs_data.feature import Feature
from rcs_data.layout import STEPS_FILE
from rcs_data.parquet import UNREADABLE
from rcs_data.reader import EpisodeRecord

# An image follows the one before, or the header of a page, which takes some 50 bytes and one bit per row.
_SEARCHED = 65536
# The first bytes of an image to look for; the rest is compared where they are found.
_START = 24
# Parquet's plain encoding puts the length before the data, in four bytes, little-endian.
_LENGTH_BYTES = 4
INDEX_BYTES = 1 << 28
"""Memory for places of images by default [B]: those of 16 million images."""


@dataclass(frozen=True, kw_only=True)
class FrameIndex:
    """Where the images of one camera of an episode are in its file."""

    path: Path
    """The file."""
    places: NDArray[np.int64]
    """Offset and size of each row's image [B], shape (length, 2); the offset -1 - i stands for the ith of `loose`."""
    loose: tuple[bytes, ...]
    """Images that are not in the file verbatim: black before the first, and those of other writers."""

    @property
    def nbytes(self) -> int:
        """The memory that it takes [B]."""
        return self.places.nbytes + sum(len(image) for image in self.loose)

    @classmethod
    def of(cls, episode: EpisodeRecord, key: str) -> FrameIndex:
        """Find the images of an episode, which reads all of that column once.

        Args:
            episode: The episode.
            key: The feature.

        Raises:
            InvalidSetup: There is no such feature, or it is not an image.
            CorruptEpisode: The file is missing or damaged.
        """
        path = episode.path / STEPS_FILE
        places: list[tuple[int, int]] = []
        loose: list[bytes] = []
        last: bytes | None = None
        position = 0
        chunks: dict[int, int] = {}
        content: mmap.mmap | None = None
        try:
            for row, image in enumerate(episode.encoded_frames(key)):
                if content is None:  # only now is the file known to be readable
                    chunks, content = _chunks(path, key), _mapped(path)
                position = chunks.get(row, position)
                if image is last:
                    places.append(places[-1])
                    continue
                start = _find(content, image, position)
                if start < 0:
                    places.append((-1 - len(loose), len(image)))
                    loose.append(image)
                else:
                    places.append((start, len(image)))
                    position = start + len(image)
                last = image
        finally:
            if content is not None:
                content.close()
        return cls(path=path, places=np.array(places, np.int64).reshape(-1, 2), loose=tuple(loose))

    def read(self, rows: Sequence[int]) -> list[bytes]:
        """Return images as stored; rows that have the same image have the same object.

        Args:
            rows: The rows, each from 0 to length - 1.

        Raises:
            CorruptEpisode: The file is gone or truncated.
        """
        images: dict[int, bytes] = {}
        places: list[tuple[int, int]] = [tuple(self.places[row].tolist()) for row in rows]
        try:
            # Opening takes 4 µs and leaves no file open, however many episodes and processes there are.
            file = os.open(self.path, os.O_RDONLY | os.O_CLOEXEC)
            try:
                for start, size in places:
                    if start not in images:
                        images[start] = self.loose[-1 - start] if start < 0 else os.pread(file, size, start)
            finally:
                os.close(file)
        except OSError as err:
            raise CorruptEpisode(f"Cannot read {self.path}: {err.strerror}.") from err
        for row, (start, size) in zip(rows, places, strict=True):
            if len(images[start]) != size:
                raise CorruptEpisode(f"{self.path} is truncated before the image of row {row}.")
        return [images[start] for start, _ in places]


class FrameAccess:
    """Reads single images of episodes; it keeps no open files, so it may be copied into processes."""

    def __init__(self, cache_bytes: int = INDEX_BYTES) -> None:
        """Start with nothing read.

        Args:
            cache_bytes: Memory for the places of images, 16 bytes each; beyond it, the least recently used episode is
                dropped and indexed again when needed.

        Raises:
            InvalidSetup: It is negative.
        """
        self._indexes: ByteCache[FrameIndex] = ByteCache(cache_bytes)
        self._decoded: dict[Feature, NDArray[Any]] = {}

    def encoded(self, episode: EpisodeRecord, key: str, rows: Sequence[int]) -> list[bytes]:
        """Return images as stored: the bytes that `EpisodeRecord.encoded_frames` yields for these rows.

        Args:
            episode: The episode.
            key: The feature.
            rows: The rows, in any order; repeated ones are read once.

        Raises:
            InvalidSetup: There is no such feature or row, or the feature is not an image.
            CorruptEpisode: The file is missing or damaged.
        """
        index = self._indexes.get((episode.path, key), lambda: _with_size(FrameIndex.of(episode, key)))
        length = len(index.places)
        wrong = [row for row in rows if not 0 <= row < length]
        if wrong:
            raise InvalidSetup(f"Episode {episode.id!r} has no row {wrong[0]}; valid are 0 to {length - 1}.")
        return index.read(rows)

    def frame(self, episode: EpisodeRecord, key: str, row: int) -> NDArray[Any]:
        """Return one image: (H, W, 3) uint8, or (H, W) uint16 millimetres for depth.

        Args:
            episode: The episode.
            key: The feature.
            row: The row.

        Raises:
            InvalidSetup: There is no such feature or row, or the feature is not an image.
            CorruptEpisode: The file is missing or damaged.
        """
        feature = episode.info.feature(key)
        out = np.empty((1, *feature.shape), feature.numpy_dtype)
        self.frames(episode, key, [row], out)
        return out[0]

    def frames(self, episode: EpisodeRecord, key: str, rows: Sequence[int], out: NDArray[Any]) -> None:
        """Decode images into an array; they equal what `EpisodeRecord.frames` yields, bit for bit.

        Args:
            episode: The episode.
            key: The feature.
            rows: The rows, in any order.
            out: Where they go, shape (len(rows), *feature.shape).

        Raises:
            InvalidSetup: There is no such feature or row, or the feature is not an image.
            CorruptEpisode: The file is missing or damaged; the message has the row.
        """
        feature = episode.info.feature(key)
        # Decoding writes line by line, which is slow outside of the processor's cache; this array is in it.
        if feature not in self._decoded:
            is_jpeg = feature.encoding == "jpeg"
            empty = pixel_buffer(feature.shape) if is_jpeg else np.empty(feature.shape, feature.numpy_dtype)
            self._decoded[feature] = empty
        image = self._decoded[feature]
        last: bytes | None = None
        for n, (row, data) in enumerate(zip(rows, self.encoded(episode, key, rows), strict=True)):
            if data is last:
                out[n] = out[n - 1]
                continue
            try:
                decode_frame(feature, data, image)
            except CorruptEpisode as err:
                raise CorruptEpisode(f"{episode.path / STEPS_FILE}, {key!r}, row {row}: {err}") from err
            out[n] = image
            last = data


def _with_size(index: FrameIndex) -> tuple[FrameIndex, int]:
    return index, index.nbytes


def _chunks(path: Path, key: str) -> dict[int, int]:
    """Return where the column begins in each row group [B], by the group's first row."""
    try:
        with parquet.opened(path) as source:
            metadata = source.file.metadata
    except UNREADABLE as err:
        raise CorruptEpisode(f"Cannot read {path}: {err}.") from err
    names = [metadata.schema.column(i).path for i in range(metadata.num_columns)]
    column = names.index(key)
    chunks: dict[int, int] = {}
    row = 0
    for i in range(metadata.num_row_groups):
        group = metadata.row_group(i)
        chunks[row] = group.column(column).data_page_offset
        row += group.num_rows
    return chunks


def _mapped(path: Path) -> mmap.mmap:
    try:
        with path.open("rb") as file:
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    except (OSError, ValueError) as err:
        raise CorruptEpisode(f"Cannot read {path}: {err}.") from err


def _find(content: mmap.mmap, image: bytes, position: int) -> int:
    """Return where an image is in a file, at or soon after a position [B]; -1 if it is not there."""
    wanted = len(image).to_bytes(_LENGTH_BYTES, "little") + image[:_START]
    end = position + _SEARCHED
    start = content.find(wanted, position, end)
    while start >= 0:
        begin = start + _LENGTH_BYTES
        if content[begin : begin + len(image)] == image:
            return begin
        start = content.find(wanted, start + 1, end)
    return -1
