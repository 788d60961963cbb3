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
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pyarrow as pa

from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.files.about import read_about
from rcs_data.files.durable import disk_errors, sealed, sync_folder, write_file
from rcs_data.files.frames_file import FramesWriter
from rcs_data.files.info import SCHEMA_VERSION, DatasetInfo
from rcs_data.files.layout import (
    ABORTED_FILE,
    EPISODE_FILE,
    FRAMES_FILE,
    ROWS_FILE,
    STEPS_FILE,
    free_folder,
    open_folder,
)
from rcs_data.files.steps_file import StepsWriter
from rcs_data.files.stream import StreamReader
from rcs_data.index.index import Index
from rcs_data.read.content import ContentHash
from rcs_data.record.timing import TimingMeter


def compact(
    index: Index,
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
        index: The dataset's index.
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
    folder = open_folder(index.root, episode_id)
    with disk_errors(f"finish episode {episode_id!r}", folder, keeps_rows=True):
        stream = StreamReader(folder / ROWS_FILE)
        header = stream.header
        if header is None or stream.schema is None:
            return None
        if not stream.schema.equals(info.stream_schema):
            raise CorruptEpisode(f"The open episode in {folder} has other columns than the dataset; it is left alone.")
        batches = stream.batches()
        first = next(batches, None)
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
        rows = (pa.Table.from_batches([batch]) for batch in itertools.chain([first], batches))
        seal(folder, info, rows, about, timing=lambda: {**(timing or {}), "is_torn": stream.is_torn})
    return publish(index, episode_id)


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
        info: What the dataset's episodes share.
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

    Raises:
        DatasetError: The disk fails, or an episode has this name.
        CorruptEpisode: Its `episode.json` is damaged.
    """
    root = index.root
    opened = open_folder(root, episode_id)
    about = read_about(opened)
    if episode_id in index.refresh():
        raise DatasetError(f"There already is an episode {episode_id!r} in {root}; the other one is in {opened}.")
    with disk_errors(f"publish episode {episode_id!r}", opened, keeps_rows=True):
        for name in (ROWS_FILE, ABORTED_FILE):
            (opened / name).unlink(missing_ok=True)
        final = free_folder(root, episode_id)
        opened.rename(final)
        sync_folder(final.parent)
        index.add(about, final.name)
    return final


@functools.cache
def library_versions() -> dict[str, str]:
    """Return the versions of the libraries that determine the written bytes."""
    return {name: version(name) for name in ("numpy", "pyarrow", "simplejpeg", "av", "isal")}
