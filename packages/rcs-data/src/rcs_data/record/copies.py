"""Episodes that were recorded elsewhere: their files, byte for byte, or their rows in another form."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.files.about import checked_about, read_about
from rcs_data.files.durable import (
    HashedFile,
    disk_errors,
    link_file,
    remove_folder,
    sealed,
    sync_folder,
    unsealed,
    write_file,
)
from rcs_data.files.info import DatasetInfo
from rcs_data.files.layout import EPISODE_FILE, FRAMES_FILE, STEPS_FILE, check_episode_id, new_trash, open_folder
from rcs_data.files.steps_file import StepsWriter
from rcs_data.index.index import Index
from rcs_data.read.episode_record import EpisodeRecord
from rcs_data.record.compact import publish, seal

Files = Mapping[str, bytes | memoryview]
"""The contents of files by name."""


def adopt(index: Index, info: DatasetInfo, episode_id: str, files: Files) -> Path:
    """Write an episode's files into a dataset, byte for byte, and return its folder.

    A kill leaves an open episode without rows, which the next writer removes, or a complete one.

    Args:
        index: The dataset's index.
        info: The facts that the dataset's episodes share; those of the dataset that the episode was recorded into are
            equal.
        episode_id: The episode. No writer may be recording it; what a dead one left of it is removed.
        files: All files of its folder.

    Raises:
        InvalidSetup: The id cannot be the name of a folder.
        CorruptEpisode: The files are not what was written, or not those of this episode of such a dataset.
        DatasetError: There is such an episode already, or the disk fails.
    """
    check_episode_id(episode_id)
    expected = {EPISODE_FILE, STEPS_FILE, *([FRAMES_FILE] if info.has_images else [])}
    if set(files) != expected:
        raise CorruptEpisode(
            f"Episode {episode_id!r} came with the files {', '.join(sorted(files)) or '(none)'}; "
            f"an episode of this dataset has {', '.join(sorted(expected))}."
        )
    root = index.root
    folder = open_folder(root, episode_id)
    description = bytes(files[EPISODE_FILE])
    about = checked_about(unsealed(description, folder / EPISODE_FILE), folder / EPISODE_FILE)
    hashes = {name: hashlib.sha256(data).hexdigest() for name, data in files.items() if name != EPISODE_FILE}
    if about["id"] != episode_id or about["sha256"] != hashes:
        raise CorruptEpisode(f"Episode {episode_id!r} did not arrive as it was written: an id or a hash differs.")
    if episode_id in index.refresh():
        raise DatasetError(f"There already is an episode {episode_id!r} in {root}; remove it, or choose another id.")
    with disk_errors(f"write episode {episode_id!r}", folder):
        if folder.exists():
            remove_folder(folder, new_trash(root, episode_id))
        folder.mkdir(parents=True)
        for name in hashes:
            file = HashedFile(folder / name)
            try:
                file.write(files[name])
                file.complete()
            finally:
                file.close()
        write_file(folder / EPISODE_FILE, description)
        sync_folder(folder)
    return publish(index, episode_id)


def link(folder: Path, info: DatasetInfo, episode: EpisodeRecord, changes: Mapping[str, Any]) -> None:
    """Write an episode of the same rows into a folder; its files become links to the same bytes.

    Args:
        folder: The folder, which is there and empty.
        info: The facts that the dataset's episodes share, with the same features.
        episode: The episode.
        changes: Fields of `episode.json` that differ. With another id, `steps.parquet`, which has it, is written anew.

    Raises:
        CorruptEpisode: The episode is damaged.
        OSError: The disk fails.
    """
    source, stored = episode.path, read_about(episode.path)
    about = {**stored, "instruction": episode.instruction, **changes}
    for name in stored["sha256"]:
        if name != STEPS_FILE or about["id"] == stored["id"]:
            link_file(source / name, folder / name)
            continue
        with StepsWriter(folder / name, info, about["id"]) as steps:
            steps.write(episode.steps())
            about["sha256"] = {**stored["sha256"], name: steps.complete()}
    if about == stored:
        link_file(source / EPISODE_FILE, folder / EPISODE_FILE)
    else:
        write_file(folder / EPISODE_FILE, sealed(about))
    sync_folder(folder)


def rewrite(
    folder: Path, info: DatasetInfo, episode: EpisodeRecord, rows: Iterable[pa.Table], changes: Mapping[str, Any]
) -> None:
    """Write an episode with new rows into a folder.

    Args:
        folder: The folder, which is there and empty.
        info: The facts that the dataset's episodes share.
        episode: Source of the other fields of `episode.json`.
        rows: The rows with the columns of `stream_schema`, in pieces.
        changes: Fields of `episode.json` that differ.

    Raises:
        CorruptEpisode: The episode is damaged.
        OSError: The disk is full or fails.
    """
    found = ("length", "content_hash", "sha256", "timing", "schema_version")
    about = episode.about
    kept = {key: value for key, value in about.items() if key not in found}
    # What cannot be computed from the rows.
    measured = {key: value for key, value in about["timing"].items() if key in ("writer", "is_torn")}
    seal(folder, info, rows, {**kept, **changes}, timing=lambda: measured)
