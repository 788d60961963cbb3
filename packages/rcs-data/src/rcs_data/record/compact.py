"""Completes an open episode: its stream becomes `steps.parquet` and `frames.zip`, and `episode.json` seals it.

A kill at any point leaves an open episode, which can be compacted again from its stream, or a complete one:

1. `steps.parquet` and `frames.zip` are written and synced inside the open folder. Without `episode.json` they are
ignored, so they need no temporary names.
2. `episode.json` is put in place in one step and the folder synced. From here on the episode is finished.
3. The stream is removed, the folder gets its final name, and the index a line.

That is six syncs with images and five without; each makes sure that no step reaches the disk before the one it
builds on, in case the power fails.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pyarrow as pa

from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.files.about import read_about
from rcs_data.files.durable import disk_errors, quarantine, sealed, sync_folder, write_file
from rcs_data.files.frames_file import FramesWriter
from rcs_data.files.info import SCHEMA_VERSION, DatasetInfo
from rcs_data.files.layout import (
    ABORTED_FILE,
    CHECKSUMS_FILE,
    EPISODE_FILE,
    FRAMES_FILE,
    OPEN_FOLDER,
    ROWS_FILE,
    STEPS_FILE,
    free_folder,
)
from rcs_data.files.steps_file import StepsWriter
from rcs_data.files.stream import StreamReader
from rcs_data.index.index import Index
from rcs_data.read.content import ContentHash
from rcs_data.record.timing import TimingMeter


def compact(
    index: Index,
    episode_id: str,
    *,
    success: bool | None,
    outcome: Mapping[str, Any],
    ended: str | None,
    instruction: str | None = None,
    timing: Mapping[str, Any] | None = None,
    rows: int | None = None,
) -> Path | None:
    """Turn the open episode's stream into a complete episode and return its folder; None if there are no rows.

    Args:
        index: The dataset's index.
        episode_id: The episode.
        success: Whether the task was done; None if that is not known.
        outcome: Further facts to keep about how it went, as JSON values.
        ended: Wall clock at the end, ISO 8601 in UTC; None if it was not measured.
        instruction: The instruction that the robot had; None for the instruction given at the start.
        timing: Additions to the timing report that the rows do not show.
        rows: How many rows were recorded; None if that is not known.

    Raises:
        DatasetError: The disk is full or fails, a complete episode has this name, or fewer rows can be read than were
            recorded; the stream stays.
        CorruptEpisode: The stream's columns differ from the dataset's, or it is damaged; it stays.
    """
    info, folder = index.info, index.root / OPEN_FOLDER / episode_id
    with disk_errors(f"finish episode {episode_id!r}", folder, keeps_rows=True):
        stream = StreamReader(folder / ROWS_FILE)
        header = stream.header
        if stream.schema is not None and not stream.schema.equals(info.stream_schema):
            raise CorruptEpisode(f"The open episode in {folder} has other columns than the dataset; it is left alone.")
        tables = _counted(stream, rows, episode_id)
        first = next(tables, None)
        if header is None or first is None:
            if stream.may_hide_rows:
                raise CorruptEpisode(f"The rows in {folder} cannot be read; they are left alone.")
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
        pieces = itertools.chain([first], tables)
        seal(folder, info, pieces, about, timing=lambda: {**(timing or {}), "is_torn": stream.is_torn})
    return publish(index, episode_id)


def _counted(stream: StreamReader, rows: int | None, episode_id: str) -> Iterator[pa.Table]:
    """Yield the rows of a stream, and raise at its end if there are fewer than were recorded, unless that is None."""
    count = 0
    for batch in stream.batches():
        count += batch.num_rows
        yield pa.Table.from_batches([batch])
    if rows not in (None, count):
        raise DatasetError(f"Only {count} of {rows} rows of episode {episode_id!r} can be read again.")


def seal(
    folder: Path,
    info: DatasetInfo,
    pieces: Iterable[pa.Table],
    about: Mapping[str, Any],
    *,
    timing: Callable[[], Mapping[str, Any]] = dict,
) -> None:
    """Write a complete episode into a folder: its rows, its images, and last the `episode.json` that makes it complete.

    Args:
        folder: Its folder, which is ignored until it has an `episode.json`.
        info: The facts that the dataset's episodes share.
        pieces: The rows, with the columns of `stream_schema`, in pieces of any size; how they are cut changes no byte.
        about: Fields of `episode.json` other than those found here: length, hashes, timing, schema version.
        timing: Returns additions to the timing report; called after the last piece.

    Raises:
        OSError: The disk is full or fails.
    """
    content, meter = ContentHash(info), TimingMeter(info)
    images = [feature.key for feature in info.features if feature.is_image]
    with contextlib.ExitStack() as files:
        files.push(functools.partial(_remove_half, folder))
        steps = files.enter_context(StepsWriter(folder / STEPS_FILE, info, about["id"]))
        frames = files.enter_context(FramesWriter(folder / FRAMES_FILE, images)) if images else None
        for rows in pieces:
            content.add(rows)
            meter.add(rows)
            steps.write(rows if frames is None else frames.numbered(rows))
        hashes = {file.name: file.complete() for file in (steps, frames) if file is not None}
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


def _remove_half(folder: Path, kind: type[BaseException] | None, *_: object) -> None:
    """Remove files that could not be completed: they would take the space that a full disk lacks."""
    if kind is not None:
        for name in (STEPS_FILE, FRAMES_FILE):
            (folder / name).unlink(missing_ok=True)


def publish(index: Index, episode_id: str) -> Path:
    """Make an open episode that has its `episode.json` one of the dataset, and return its folder.

    Its stream is removed, or put into quarantine if it could not be read to its end.

    Raises:
        DatasetError: The disk fails, or an episode has this name.
        CorruptEpisode: Its `episode.json` is damaged.
    """
    root = index.root
    opened = root / OPEN_FOLDER / episode_id
    about = read_about(opened)
    if episode_id in index.refresh():
        raise DatasetError(f"There already is an episode {episode_id!r} in {root}; the other one is in {opened}.")
    with disk_errors(f"publish episode {episode_id!r}", opened, keeps_rows=True):
        if about["timing"].get("is_torn") and (opened / ROWS_FILE).exists():
            quarantine(root, opened / ROWS_FILE, f"open-{episode_id}.arrows")
        for name in (ROWS_FILE, CHECKSUMS_FILE, ABORTED_FILE):
            (opened / name).unlink(missing_ok=True)
        final = free_folder(root, episode_id)
        final.parent.mkdir(exist_ok=True)  # a copy may lack empty folders
        opened.rename(final)
        sync_folder(final.parent)
        index.add(about, final.name)
    return final


@functools.cache
def library_versions() -> dict[str, str]:
    """Return the versions of the libraries that determine the written bytes."""
    return {name: version(name) for name in ("numpy", "pyarrow", "simplejpeg", "av", "isal")}
