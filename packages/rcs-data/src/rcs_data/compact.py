"""Completes an open episode: its stream becomes Parquet files, and `episode.json` seals it.

A kill at any point leaves an open episode, which can be compacted again from its stream, or a complete one:

1. `steps.parquet` and `sim_state.parquet` are written and synced inside the open folder. Without `episode.json` they
are ignored, so they need no temporary names.
2. `episode.json` is put in place in one step and the folder synced. From here on the episode is finished.
3. The stream is removed, the folder gets its final name, and the index a line.

That is six syncs with a simulation and five without; each makes sure that no step reaches the disk before the one it
builds on, in case the power fails.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from rcs_data.about import read_about
from rcs_data.content import ContentHash
from rcs_data.durable import HashedFile, disk_errors, sealed, sync_folder, write_file
from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.info import SCHEMA_VERSION, DatasetInfo
from rcs_data.journal import Journal
from rcs_data.layout import (
    ABORTED_FILE,
    EPISODE_FILE,
    ROWS_FILE,
    SIM_STATE_FILE,
    STEPS_FILE,
    free_folder,
    open_folder,
)
from rcs_data.rows import SIM_STATE, sim_state_schema, steps_schema, stream_schema
from rcs_data.stream import StreamReader
from rcs_data.timing import TimingMeter

# Rows per Parquet row group. It is fixed, so that the bytes do not depend on how the stream was flushed, and small with
# images, so that compacting needs little memory and a reader can stop after some frames.
_GROUP_OF_NUMBERS = 16384
_GROUP_OF_IMAGES = 256


def compact(
    journal: Journal,
    episode_id: str,
    info: DatasetInfo,
    *,
    success: bool | None,
    outcome: Mapping[str, Any],
    ended: str | None,
    instruction: str | None = None,
    timing: Mapping[str, Any] | None = None,
) -> Path | None:
    """Turn the open episode's stream into a complete episode and return its folder; None if there are no rows.

    Args:
        journal: The dataset's index.
        episode_id: The episode.
        info: What the dataset's episodes share.
        success: Whether the task was done; None if that is not known.
        outcome: What else to keep about how it went, as JSON values.
        ended: Wall clock at the end, ISO 8601 in UTC; None if it was not measured.
        instruction: What the robot was asked to do; None for the instruction given at the start.
        timing: Additions to the timing report that the rows do not show.

    Raises:
        DatasetError: The disk is full or fails, or a complete episode has this name; the stream stays.
        CorruptEpisode: The stream's columns differ from the dataset's.
    """
    folder = open_folder(journal.root, episode_id)
    with disk_errors(f"finish episode {episode_id!r}", folder):
        stream = StreamReader(folder / ROWS_FILE)
        header = stream.header
        if header is None or stream.schema is None:
            return None
        if not stream.schema.equals(stream_schema(info)):
            raise CorruptEpisode(f"The open episode in {folder} has other columns than the dataset; it is left alone.")
        groups = _groups(stream, info)
        first = next(groups, None)
        if first is None:
            return None
        about = {
            "id": header.id,
            "seed": header.seed,
            "success": success,
            "outcome": dict(outcome),
            "instruction": header.instruction if instruction is None else instruction,
            "started": header.started,
            "ended": ended,
            "versions": header.versions,
        }
        rows = _chain(first, groups)
        seal(folder, info, rows, about, timing=lambda: {**(timing or {}), "is_torn": stream.is_torn})
    return publish(journal, episode_id)


def seal(
    folder: Path,
    info: DatasetInfo,
    groups: Iterable[pa.Table],
    about: Mapping[str, Any],
    *,
    timing: Callable[[], Mapping[str, Any]] = dict,
) -> None:
    """Write a complete episode into a folder: its rows as Parquet, and last the `episode.json` that makes it complete.

    Args:
        folder: Its folder, which is ignored until it has an `episode.json`.
        info: What the dataset's episodes share.
        groups: The rows, with the columns of `stream_schema`, one table per row group.
        about: Fields of `episode.json` other than those found here: length, hashes, timing, schema version.
        timing: Returns additions to the timing report; called after the last group.

    Raises:
        OSError: The disk is full or fails.
    """
    content, meter = ContentHash(info), TimingMeter(info)
    with contextlib.ExitStack() as files:
        steps = files.enter_context(_ParquetFile(folder / STEPS_FILE, steps_schema(info)))
        states = None
        if info.sim_state_size is not None:
            states = files.enter_context(_ParquetFile(folder / SIM_STATE_FILE, sim_state_schema(info.sim_state_size)))
        for group in groups:
            rows = group.select(steps.schema.names)
            steps.write(rows)
            content.add(rows)
            meter.add(rows)
            if states is not None:
                states.write(group.select([SIM_STATE]))
        hashes = {file.name: file.complete() for file in (steps, states) if file is not None}
    whole = {
        "schema_version": SCHEMA_VERSION,
        **about,
        "length": steps.rows,
        "content_hash": content.hexdigest(),
        "sha256": hashes,
        "timing": {**meter.report(), **timing()},
    }
    write_file(folder / EPISODE_FILE, sealed(whole))
    sync_folder(folder)


def cut(table: pa.Table, info: DatasetInfo) -> Iterator[pa.Table]:
    """Yield a table in row groups of the size used by recordings, so that equal rows make equal files."""
    size = _group_size(info)
    for start in range(0, table.num_rows, size):
        yield table.slice(start, size).combine_chunks()


def publish(journal: Journal, episode_id: str) -> Path:
    """Make an open episode that has its `episode.json` one of the dataset, and return its folder.

    Raises:
        DatasetError: The disk fails, or an episode has this name.
        CorruptEpisode: Its `episode.json` is damaged.
    """
    root = journal.root
    opened = open_folder(root, episode_id)
    about = read_about(opened)
    if episode_id in journal.refresh().episodes:
        raise DatasetError(f"There already is an episode {episode_id!r} in {root}; the other one is in {opened}.")
    with disk_errors(f"publish episode {episode_id!r}", opened):
        for name in (ROWS_FILE, ABORTED_FILE):
            (opened / name).unlink(missing_ok=True)
        final = free_folder(root, episode_id)
        opened.rename(final)
        sync_folder(final.parent)
        journal.add(about, final.name)
    return final


@functools.cache
def library_versions() -> dict[str, str]:
    """Return the versions of the libraries that determine the written bytes."""
    return {name: version(name) for name in ("numpy", "pyarrow", "simplejpeg")}


class _ParquetFile:
    """A Parquet file that is written group by group and hashed on the way."""

    def __init__(self, path: Path, schema: pa.Schema) -> None:
        self.name = path.name
        self.schema = schema
        self.rows = 0
        self._file = HashedFile(path)
        leaves = {field.name: _leaf(field) for field in schema}
        # JPEG and depth are compressed already.
        compression: Any = {leaf: "none" if _is_image(schema.field(key)) else "zstd" for key, leaf in leaves.items()}
        self._writer = pq.ParquetWriter(
            self._file,
            schema,
            use_dictionary=False,
            write_statistics=False,
            write_page_checksum=True,
            compression=compression,
            compression_level={leaf: 1 for key, leaf in leaves.items() if not _is_image(schema.field(key))},
        )

    def __enter__(self) -> _ParquetFile:
        return self

    def __exit__(self, *_: object) -> None:
        # In this order: after a failure the Parquet writer still writes its footer, which a closed file drops.
        self._file.close()
        self._writer.close()

    def write(self, group: pa.Table) -> None:
        """Append a row group."""
        self._writer.write_table(group, row_group_size=max(group.num_rows, 1))
        self.rows += group.num_rows

    def complete(self) -> str:
        """Write the footer, bring the file to the disk and return its SHA-256."""
        self._writer.close()
        return self._file.complete()


def _group_size(info: DatasetInfo) -> int:
    return _GROUP_OF_IMAGES if any(feature.is_image for feature in info.features) else _GROUP_OF_NUMBERS


def _groups(stream: StreamReader, info: DatasetInfo) -> Iterator[pa.Table]:
    size = _group_size(info)
    waiting: list[pa.RecordBatch] = []
    rows = 0
    for batch in stream.batches():
        while rows + batch.num_rows >= size:
            head = size - rows
            yield pa.Table.from_batches([*waiting, batch.slice(0, head)]).combine_chunks()
            waiting, rows, batch = [], 0, batch.slice(head)
        if batch.num_rows:
            waiting.append(batch)
            rows += batch.num_rows
    if waiting:
        yield pa.Table.from_batches(waiting).combine_chunks()


def _chain(first: pa.Table, rest: Iterator[pa.Table]) -> Iterator[pa.Table]:
    yield first
    yield from rest


def _leaf(field: pa.Field) -> str:
    return f"{field.name}.list.element" if pa.types.is_fixed_size_list(field.type) else field.name


def _is_image(field: pa.Field) -> bool:
    return pa.types.is_binary(field.type)
