"""Looks for damage in a dataset, and says in which episode, file and row it is."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from rcs.data.codec import decode_frame
from rcs.data.content import ContentHash, flat_numbers
from rcs.data.head import read_head, read_head_file
from rcs.data.info import DatasetInfo
from rcs.data.layout import (
    COPY_FILE,
    DATASET_FILE,
    EPISODE_FILE,
    SIM_STATE_FILE,
    STEPS_FILE,
    complete_ids,
    episode_folder,
    generation_folder,
    incomplete_ids,
    open_folder,
    open_ids,
    trash_folders,
)
from rcs.data.lock import is_locked
from rcs.data.reader import EpisodeRecord
from rcs.data.rows import sim_state_schema, steps_schema
from rcs.errors import CorruptEpisode, DatasetError


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that is wrong."""

    episode: str | None
    """The episode's id; None for the dataset as a whole."""
    file: str
    """The file, relative to the dataset's folder."""
    message: str
    """What is wrong, and what to do if anything can be done."""
    rows: tuple[int, int] | None = None
    """The first and the last row that are touched, if that is known."""

    def __str__(self) -> str:
        """Return the finding on one line."""
        place = ""
        if self.rows is not None:
            first, last = self.rows
            place = f", row {first}" if first == last else f", rows {first} to {last}"
        return f"{self.file}{place}: {self.message}"


@dataclass(frozen=True, kw_only=True)
class CheckReport:
    """What `check` looked at and found."""

    path: Path
    """The dataset's folder."""
    episodes: int
    """Complete episodes that were checked."""
    rows: int
    """Rows in them."""
    frames: int
    """Images that were decoded."""
    findings: tuple[Finding, ...]
    """All that is wrong."""

    @property
    def is_ok(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings

    def __str__(self) -> str:
        """Return one line per finding and a summary."""
        summary = f"{self.episodes} episodes, {self.rows} rows, {self.frames} images checked: "
        summary += "all as it was written" if self.is_ok else f"{len(self.findings)} findings"
        return "\n".join([*map(str, self.findings), summary])


def check(path: str | Path, *, decode_frames: bool = True) -> CheckReport:
    """Check every episode of a dataset against what was written.

    Args:
        path: The dataset's folder.
        decode_frames: Whether each image is decoded too, which takes most of the time.

    Raises:
        DatasetError: There is no dataset, or its layout is newer than this code.
    """
    root = Path(path)
    try:
        head = read_head(root)
    except CorruptEpisode as err:
        damage = Finding(episode=None, file=DATASET_FILE, message=str(err))
        return CheckReport(path=root, episodes=0, rows=0, frames=0, findings=(damage,))
    info, base = head.info, generation_folder(root, head.generation)
    findings = list(_loose_ends(root, base))
    ids = complete_ids(base)
    rows = frames = 0
    for episode_id in ids:
        episode = _EpisodeCheck(root, base, info, episode_id)
        findings += episode.findings(decode_frames)
        rows += episode.rows
        frames += episode.frames
    return CheckReport(path=root, episodes=len(ids), rows=rows, frames=frames, findings=tuple(findings))


def _loose_ends(root: Path, base: Path) -> Iterator[Finding]:
    for name in (DATASET_FILE, COPY_FILE):
        try:
            read_head_file(root / name)
        except (CorruptEpisode, DatasetError) as err:
            if name == DATASET_FILE or (root / COPY_FILE).exists():  # the first layout had no copy
                yield Finding(episode=None, file=name, message=str(err))
    for episode_id in incomplete_ids(base):
        file = str((episode_folder(base, episode_id) / EPISODE_FILE).relative_to(root))
        yield Finding(episode=episode_id, file=file, message="missing, so the episode is not read")
    if is_locked(root):
        return  # open episodes are what a living writer is at
    for episode_id in open_ids(base):
        file = str(open_folder(base, episode_id).relative_to(root))
        yield Finding(episode=episode_id, file=file, message="open, and its writer is gone; run recover")
    for folder in trash_folders(base):
        yield Finding(episode=None, file=str(folder.relative_to(root)), message="left of a discard; run recover")


class _EpisodeCheck:
    def __init__(self, root: Path, base: Path, info: DatasetInfo, episode_id: str) -> None:
        self._info = info
        self._root = root
        self._episode = EpisodeRecord(episode_folder(base, episode_id), info)
        self.rows = 0
        self.frames = 0

    def findings(self, decode_frames: bool) -> Iterator[Finding]:
        """Yield what is wrong in this episode."""
        try:
            hashes = dict(self._episode.about["sha256"])
            self.rows = self._episode.length
        except (CorruptEpisode, DatasetError, KeyError) as err:
            yield self._finding(EPISODE_FILE, str(err))
            return
        schemas = {STEPS_FILE: steps_schema(self._info)}
        if self._info.sim_state_size is not None:
            schemas[SIM_STATE_FILE] = sim_state_schema(self._info.sim_state_size)
        for name, schema in schemas.items():
            path = self._episode.path / name
            if not path.exists():
                yield self._finding(name, "missing")
                continue
            found = list(self._check_parquet(name, schema, decode_frames))
            if _sha256(path) != hashes.get(name) and not found:
                found = [self._finding(name, "its SHA-256 is not the one that was written")]
            yield from found

    def _check_parquet(self, name: str, schema: pa.Schema, decode_frames: bool) -> Iterator[Finding]:
        path = self._episode.path / name
        try:
            file = pq.ParquetFile(path, page_checksum_verification=True)
        except (pa.ArrowException, OSError) as err:
            yield self._finding(name, f"its footer does not read: {err}")
            return
        with file:
            if not file.schema_arrow.equals(schema):
                yield self._finding(name, "has other columns than dataset.json says")
                return
            if file.metadata.num_rows != self.rows:
                yield self._finding(name, f"has {file.metadata.num_rows} rows, and episode.json says {self.rows}")
            content = ContentHash(self._info) if name == STEPS_FILE else None
            first = 0
            for group in range(file.num_row_groups):
                rows = file.metadata.row_group(group).num_rows
                damaged = False
                columns: list[pa.ChunkedArray] = []
                for key in schema.names:
                    try:
                        column = file.read_row_group(group, columns=[key], use_threads=False).column(0)
                    except (pa.ArrowException, OSError) as err:
                        damaged = True
                        place = self._locate(path, key, group) or (0, rows - 1)
                        place = (first + place[0], first + place[1])
                        yield self._finding(name, f"{key!r} does not read: {err}", place)
                        continue
                    columns.append(column)
                    yield from self._check_column(name, key, column, first, decode_frames)
                if damaged:
                    content = None
                elif content is not None:
                    content.add(pa.Table.from_arrays(columns, schema=schema))
                first += rows
        if content is not None and content.hexdigest() != self._episode.content_hash:
            yield self._finding(name, "its values are not those that were written")

    def _locate(self, path: Path, key: str, group: int) -> tuple[int, int] | None:
        """Return the first and last row of a group whose image is broken, if reading past the checksum shows them."""
        try:
            with pq.ParquetFile(path) as file:
                column = file.read_row_group(group, columns=[key], use_threads=False).column(0)
        except (pa.ArrowException, OSError):
            return None
        if not pa.types.is_binary(column.type):
            return None
        broken = [row for row, image in enumerate(column) if image.is_valid and not self._decodes(key, image.as_py())]
        return (broken[0], broken[-1]) if broken else None

    def _decodes(self, key: str, image: bytes) -> bool:
        try:
            decode_frame(self._info.feature(key), image)
        except CorruptEpisode:
            return False
        return True

    def _check_column(
        self, name: str, key: str, column: pa.ChunkedArray, first: int, decode_frames: bool
    ) -> Iterator[Finding]:
        if pa.types.is_binary(column.type):
            for row, image in enumerate(column if decode_frames else ()):
                if not image.is_valid:
                    continue
                try:
                    decode_frame(self._info.feature(key), image.as_py())
                    self.frames += 1
                except CorruptEpisode as err:
                    yield self._finding(name, f"{key!r}: {err}", (first + row, first + row))
            return
        numbers = flat_numbers(column).reshape(len(column), -1)
        if numbers.dtype.kind == "f":
            bad = np.flatnonzero(~np.isfinite(numbers).all(axis=1))
            if len(bad):
                message = f"{key!r} is not finite in {len(bad)} rows"
                yield self._finding(name, message, (first + int(bad[0]), first + int(bad[-1])))

    def _finding(self, name: str, message: str, rows: tuple[int, int] | None = None) -> Finding:
        file = (self._episode.path / name).relative_to(self._root)
        return Finding(episode=self._episode.id, file=str(file), message=message, rows=rows)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
