"""Checks that an episode's files are what was written, byte for byte, and that every image decodes."""

from __future__ import annotations

import errno
import hashlib
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rcs_data.check.episode_rows import EpisodePlace, EpisodeRows
from rcs_data.check.folder import is_as_written
from rcs_data.check.report import Finding, counted
from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.files.about import read_about
from rcs_data.files.codec import decode_frame
from rcs_data.files.feature import NOTES
from rcs_data.files.frames_file import FramesFile
from rcs_data.files.info import DatasetInfo
from rcs_data.files.json_file import read_bytes
from rcs_data.files.layout import EPISODE_FILE, FRAMES_FILE, STEPS_FILE
from rcs_data.read.content import ContentHash, flat_numbers
from rcs_data.read.episode_record import EpisodeRecord, decoded

# An image without a value above this is black; JPEG turns 0 into up to 2.
_BLACK = 8


class EpisodeBytes:
    """Checks the files of one episode and keeps the rows that the other checks need.

    The files are read, not mapped, so that an unreadable sector raises an error instead of ending the process.
    """

    def __init__(self, place: EpisodePlace, info: DatasetInfo, *, depth: Literal["bytes", "rows", "frames"]) -> None:
        self._place = place
        self._info = info
        self._reads_rows = depth != "bytes"
        self._decode_frames = depth == "frames"
        self.rows = EpisodeRows(info)
        self.frames = 0
        """Number of decoded images."""

    def findings(self) -> Iterator[Finding]:
        """Yield all damage, and numbers that are not finite as warnings."""
        path = self._place.folder / EPISODE_FILE
        try:
            about = read_about(self._place.folder)
            written = read_bytes(path)
        except DatasetError as err:
            yield self._damage("other_layout", str(err), EPISODE_FILE)
            return
        except CorruptEpisode as err:
            yield self._damage("altered", str(err), EPISODE_FILE)
            return
        if not is_as_written(written, about):
            yield self._damage("altered", "is readable, but its bytes are not those that were written", EPISODE_FILE)
        self.rows.about = about
        altered = yield from self._altered_files()
        if STEPS_FILE not in altered and (altered or self._reads_rows):
            yield from self._locate() if altered else self._check_rows()

    def _altered_files(self) -> Generator[Finding, None, set[str]]:
        """Compare the files with their hashes; return the names of those that differ."""
        altered: set[str] = set()
        for name in self.rows.about["sha256"]:
            path = self._place.folder / name
            try:
                if sha256_of(path) == self.rows.about["sha256"].get(name):
                    continue
                yield self._damage("altered", "its SHA-256 differs from the one that was written", name)
            except FileNotFoundError:
                yield self._damage("missing", "no file" if path.exists() else "missing", name)
            except OSError as err:
                yield self._damage("unreadable", f"cannot be read: {err.strerror or err}", name)
            altered.add(name)
        return altered

    def _check_rows(self) -> Iterator[Finding]:
        content, pieces, not_finite = ContentHash(self._info), list[pa.Table](), dict[str, list[int]]()
        first = 0
        try:
            for rows in EpisodeRecord(self._place.folder, self._info).rows():
                for key in self.rows.frames:
                    yield from self._check_images(key, rows.column(key), first)
                content.add(rows)
                pieces.append(rows.select(self.rows.wanted))
                for key in rows.column_names:
                    if key not in self.rows.frames and not key.startswith(NOTES):
                        bad = _not_finite(rows.column(key), rows.num_rows)
                        not_finite.setdefault(key, []).extend((first + bad).tolist())
                first += rows.num_rows
        except CorruptEpisode as err:
            yield self._damage("unreadable", str(err), STEPS_FILE)
            return
        self.rows.length = first
        if pieces:
            self.rows.numbers = pa.concat_tables(pieces)
        for key, bad in not_finite.items():
            if bad:
                message = f"{key!r} is not finite in {counted(len(bad), 'row')}"
                yield self._place.warning("not_finite", message, np.array(bad))
        if content.hexdigest() != self.rows.about["content_hash"]:
            yield self._damage("content", "its values are not those that were written", STEPS_FILE)

    def _check_images(self, key: str, column: pa.ChunkedArray, first: int) -> Iterator[Finding]:
        feature, log = self._info.feature(key), self.rows.frames[key]
        for row, image in enumerate(column, first):
            data: bytes | None = image.as_py()
            is_black = False
            if data is not None and self._decode_frames:
                try:
                    darkest = 0 if feature.colour is None else _BLACK
                    is_black = int(decode_frame(feature, data).max()) <= darkest
                    self.frames += 1
                except CorruptEpisode as err:
                    yield self._damage("image", f"{key!r}: {err}", FRAMES_FILE, (row, row))
            log.is_new.append(data is not None)
            log.is_same.append(data is not None and data == log.last)
            log.is_black.append(is_black)
            log.last = data or log.last

    def _locate(self) -> Iterator[Finding]:
        """Name the rows whose images can no longer be read, of a file that is not what was written."""
        record = EpisodeRecord(self._place.folder, self._info)
        features = [feature for feature in self._info.features if feature.is_image]
        try:
            numbers = record.image_numbers(feature.key for feature in features)
            images = FramesFile(record.path / FRAMES_FILE)
        except CorruptEpisode as err:
            if (record.path / FRAMES_FILE).is_file():
                yield self._damage("unreadable", str(err), FRAMES_FILE)
            return
        for feature in features:
            broken: list[int] = []
            column = numbers[feature.key]
            for row in np.flatnonzero(np.diff(column, prepend=-1)).tolist():
                try:
                    decoded(feature, images, int(column[row]), row)
                except CorruptEpisode:
                    broken.append(row)
            if broken:
                message = f"{feature.key!r} cannot be read in {counted(len(broken), 'row')} with a new image"
                yield self._damage("image", message, FRAMES_FILE, (broken[0], broken[-1]))

    def _damage(self, kind: str, message: str, file: str, rows: tuple[int, int] | None = None) -> Finding:
        return self._place.finding("damage", kind, message, file=file, rows=rows)


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file.

    Raises:
        OSError: It cannot be read.
    """
    if not path.is_file():  # reading a pipe would never end
        raise FileNotFoundError(errno.ENOENT, "it is missing or not a file", str(path))
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def _not_finite(column: pa.ChunkedArray, rows: int) -> NDArray[np.intp]:
    """Return the rows in which a number of a column is not finite."""
    numbers = flat_numbers(column)
    if numbers.dtype.kind != "f":
        return np.empty(0, np.intp)
    return np.flatnonzero(~np.isfinite(numbers.reshape(rows, -1)).all(axis=1))
