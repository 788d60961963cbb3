"""Copies of episodes that were recorded elsewhere: the same rows, or others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from rcs_data.files.about import read_about
from rcs_data.files.durable import link_file, sealed, sync_folder, write_file
from rcs_data.files.info import DatasetInfo
from rcs_data.files.layout import EPISODE_FILE, STEPS_FILE
from rcs_data.files.steps_file import StepsWriter
from rcs_data.read.episode_record import EpisodeRecord
from rcs_data.record.compact import seal


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
    # These cannot be computed from the rows.
    measured = {key: value for key, value in about["timing"].items() if key in ("writer", "is_torn")}
    seal(folder, info, rows, {**kept, **changes}, timing=lambda: measured)
