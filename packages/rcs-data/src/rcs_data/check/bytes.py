"""Checks that an episode's files are what was written, byte for byte, and that every image decodes."""

from __future__ import annotations

import errno
import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa

from rcs_data import parquet
from rcs_data.about import read_about
from rcs_data.check.episode_rows import EpisodePlace, EpisodeRows
from rcs_data.check.folder import is_as_written
from rcs_data.check.report import Finding, counted
from rcs_data.codec import decode_frame
from rcs_data.content import ContentHash, flat_numbers
from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.info import DatasetInfo
from rcs_data.json_file import read_bytes
from rcs_data.layout import EPISODE_FILE, SIM_STATE_FILE, STEPS_FILE
from rcs_data.parquet import UNREADABLE, ParquetSource
from rcs_data.rows import sim_state_schema, steps_schema
from rcs_data.timing import TimingMeter

# An image without a value above this is black; JPEG turns 0 into up to 2.
_BLACK = 8


class EpisodeBytes:
    """Checks the files of one episode and keeps the rows that the other checks need.

    The files are read, not mapped, so that an unreadable sector raises an error instead of ending the process.
    """

    def __init__(self, place: EpisodePlace, info: DatasetInfo, *, depth: Literal["bytes", "rows", "frames"]) -> None:
        """Prepare the check.

        Args:
            place: Where the episode is.
            info: What the dataset's episodes share.
            depth: Whether to read the rows, and to decode each image.
        """
        self._place = place
        self._info = info
        self._reads_rows = depth != "bytes"
        self._decode_frames = depth == "frames"
        self.rows = EpisodeRows(info)
        self.frames = 0
        """Number of decoded images."""
        self.timing: dict[str, Any] = {}
        """The timing report computed from the rows."""

    def findings(self) -> Iterator[Finding]:
        """Yield all damage, and numbers that are not finite as warnings."""
        try:
            about = read_about(self._place.folder)
        except DatasetError as err:
            yield self._damage("other_layout", str(err), EPISODE_FILE)
            return
        except CorruptEpisode as err:
            yield self._damage("altered", str(err), EPISODE_FILE)
            return
        path = self._place.folder / EPISODE_FILE
        if not is_as_written(read_bytes(path), about):
            yield self._damage("altered", "is readable, but its bytes are not those that were written", EPISODE_FILE)
        self.rows.about = about
        for name, schema in schemas_of(self._info).items():
            yield from self._check_file(name, schema)

    def _check_file(self, name: str, schema: pa.Schema) -> Iterator[Finding]:
        path = self._place.folder / name
        if not path.is_file():
            yield self._damage("missing", "no file" if path.exists() else "missing", name)
            return
        try:
            is_altered = sha256_of(path) != self.rows.about["sha256"].get(name)
        except OSError as err:
            yield self._damage("unreadable", f"cannot be read: {err.strerror or err}", name)
            return
        if not is_altered:
            if self._reads_rows:
                yield from self._check_parquet(name, schema)
            return
        try:
            found = list(self._check_parquet(name, schema))
        except (ValueError, IndexError) as err:  # a contradictory footer
            found = [self._damage("unreadable", f"cannot be read: {err}", name)]
        if not any(finding.severity == "damage" for finding in found):
            found.append(self._damage("altered", "its SHA-256 differs from the one that was written", name))
        yield from found

    def _check_parquet(self, name: str, schema: pa.Schema) -> Iterator[Finding]:
        path = self._place.folder / name
        try:
            with parquet.opened(path) as source:
                if not source.file.schema_arrow.equals(schema):
                    yield self._damage("schema", "its columns differ from those in dataset.json", name)
                    return
                length = self.rows.about["length"]
                if source.rows != length:
                    yield self._damage("row_count", f"has {source.rows} rows, but episode.json says {length}", name)
                source.require(is_damaged=True)  # of all columns, since the checks need them
                yield from self._check_groups(source, name, schema)
        except (*UNREADABLE, CorruptEpisode) as err:
            yield self._damage("unreadable", f"its footer cannot be read: {err}", name)

    def _check_groups(self, source: ParquetSource, name: str, schema: pa.Schema) -> Iterator[Finding]:
        file = source.file
        content, meter = (ContentHash(self._info), TimingMeter(self._info)) if name == STEPS_FILE else (None, None)
        not_finite = _NotFinite()
        is_whole = True
        first = 0
        for group in range(file.num_row_groups):
            rows = file.metadata.row_group(group).num_rows
            columns: list[pa.ChunkedArray] = []
            for key in schema.names:
                try:
                    column = source.table([key], [group]).column(0)
                except (*UNREADABLE, CorruptEpisode) as err:
                    is_whole = False
                    start, end = self._locate(name, key, group) or (0, rows - 1)
                    place = (first + start, first + end)
                    yield self._damage("unreadable", f"{key!r} cannot be read: {err}", name, place)
                    continue
                columns.append(column)
                if pa.types.is_binary(column.type):
                    yield from self._check_images(key, column, first)
                else:
                    not_finite.add(key, column, first)
            if is_whole and content is not None and meter is not None:
                table = pa.Table.from_arrays(columns, schema=schema)
                content.add(table)
                meter.add(table)
                self.rows.add(table)
            first += rows
        for key, (number, start, end) in not_finite.found.items():
            message = f"{key!r} is not finite in {counted(number, 'row')}"
            yield self._place.finding("warning", "not_finite", message, file=name, rows=(start, end))
        if is_whole and content is not None and meter is not None:
            self.timing = meter.report()
            if content.hexdigest() != self.rows.about["content_hash"]:
                yield self._damage("content", "its values are not those that were written", name)

    def _check_images(self, key: str, column: pa.ChunkedArray, first: int) -> Iterator[Finding]:
        feature, log = self._info.feature(key), self.rows.frames[key]
        for row, image in enumerate(column):
            data: bytes | None = image.as_py()
            is_black = False
            if data is not None and self._decode_frames:
                try:
                    darkest = 0 if feature.encoding in ("depth", "labels") else _BLACK
                    is_black = int(decode_frame(feature, data).max()) <= darkest
                    self.frames += 1
                except CorruptEpisode as err:
                    place = (first + row, first + row)
                    yield self._damage("image", f"{key!r}: {err}", STEPS_FILE, place)
            log.is_new.append(data is not None)
            log.is_same.append(data is not None and data == log.last)
            log.is_black.append(is_black)
            log.last = data or log.last

    def _locate(self, name: str, key: str, group: int) -> tuple[int, int] | None:
        """Return the first and last row of a group with a broken image, if they can be read despite the checksum."""
        try:
            with parquet.opened(self._place.folder / name, verify=False) as source:
                column = source.table([key], [group]).column(0)
        except (*UNREADABLE, CorruptEpisode):
            return None
        if not pa.types.is_binary(column.type):
            return None
        images = (image.as_py() for image in column)
        broken = [row for row, image in enumerate(images) if image is not None and not self._decodes(key, image)]
        return (broken[0], broken[-1]) if broken else None

    def _decodes(self, key: str, image: bytes) -> bool:
        try:
            decode_frame(self._info.feature(key), image)
        except CorruptEpisode:
            return False
        return True

    def _damage(self, kind: str, message: str, file: str, rows: tuple[int, int] | None = None) -> Finding:
        return self._place.finding("damage", kind, message, file=file, rows=rows)


class _NotFinite:
    """Counts the rows of each column with NaN or infinity."""

    def __init__(self) -> None:
        self.found: dict[str, tuple[int, int, int]] = {}

    def add(self, key: str, column: pa.ChunkedArray, first: int) -> None:
        """Take the next rows of a column, starting at row `first`."""
        if not len(column):
            return  # without rows, numpy cannot infer the size of one
        numbers = flat_numbers(column).reshape(len(column), -1)
        if numbers.dtype.kind != "f":
            return
        bad = np.flatnonzero(~np.isfinite(numbers).all(axis=1))
        if len(bad):
            number, start, _ = self.found.get(key, (0, first + int(bad[0]), 0))
            self.found[key] = (number + len(bad), start, first + int(bad[-1]))


def schemas_of(info: DatasetInfo) -> dict[str, pa.Schema]:
    """Return the schema of each Parquet file of an episode by its name."""
    schemas = {STEPS_FILE: steps_schema(info)}
    if info.sim_state_size is not None:
        schemas[SIM_STATE_FILE] = sim_state_schema(info.sim_state_size)
    return schemas


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
