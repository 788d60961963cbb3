"""Imports a LeRobotDataset, v2.0, v2.1 or v3.0, whether exported by RCS or not.

T frames become T + 1 rows: row i has the observation of frame i, row i + 1 its action. LeRobot does not keep the
observation after the last frame, so that row T repeats that of row T - 1, as `steps` says.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rcs_data.convert.labels import LABELS, numbered
from rcs_data.convert.lerobot.layout import PROVENANCE_FILE, SUCCESS
from rcs_data.convert.lerobot.mapping import FeatureMapping, feature_mapping
from rcs_data.convert.lerobot.source import LeRobotSource, SourceEpisode, refuse_pointer
from rcs_data.convert.lerobot.video import VideoReader
from rcs_data.convert.options import ImportOptions, selected_numbers
from rcs_data.convert.provenance import checked_provenance
from rcs_data.convert.steps import EpisodeAbout, Record, StepColumn, import_episodes, leave_out, record_steps
from rcs_data.errors import CorruptEpisode, InvalidSetup
from rcs_data.files.info import MEANING_OF_ACTIONS, DatasetInfo
from rcs_data.files.json_file import read_json_lines
from rcs_data.read.reader import Dataset
from rcs_data.record.writer import DatasetWriter

# LeRobot's own tolerance between a stamp and frame / fps is 1e-4 s.
_ON_GRID_S = 1e-4


def is_lerobot(source: Path) -> bool:
    """Return whether a folder looks like a LeRobotDataset."""
    return (source / "meta" / "info.json").is_file()


def import_lerobot(source: str | Path, out: str | Path, options: ImportOptions | None = None) -> Dataset:
    """Import a LeRobotDataset or a part of it; an error leaves nothing.

    Numbers keep the source's dtype, which is float32 for vectors of our exports. JPEG files in its tables stay as they
    are; other images are compressed again. Success is known only if the source has `next.success` or is our export.

    Args:
        source: The folder of the LeRobotDataset.
        out: The folder to make.
        options: Says what to import, and how images are stored.

    Raises:
        DatasetError: There is no such dataset, `out` exists, or the disk fails.
        CorruptEpisode: The source is damaged or incomplete, and `allow_missing` is not set.
        InvalidSetup: The source has nothing to import, or an option names an unknown episode or camera.
    """
    options = options or ImportOptions()
    given = LeRobotSource(Path(source))
    chosen = selected_numbers(options.episodes, given.lengths)
    mapping = feature_mapping(given, options, _carrying(given, chosen, options))
    reading = _Reading(given, mapping, options, _provenance(given), {})
    info, steps = _info(given, mapping, options), sum(given.lengths[index] for index in chosen)
    try:
        return import_episodes(out, info, reading.episodes(chosen), options, steps)
    finally:
        for reader in reading.readers.values():
            reader.close()


@dataclass(frozen=True)
class _Reading:
    """Makes episodes of the source's rows and images."""

    source: LeRobotSource
    mapping: FeatureMapping
    options: ImportOptions
    provenance: Mapping[int, dict[str, Any]]
    readers: dict[str, VideoReader]
    """Open videos by column; the next episode may continue in the same one."""

    def episodes(self, chosen: Iterable[int]) -> Iterator[tuple[int, Record]]:
        """Yield what records each episode; those that cannot be read are left out, if that is allowed."""
        for path, numbers in self.source.files([*chosen]).items():
            left = dict.fromkeys(numbers)
            try:
                for episode in self.source.episodes(path, numbers):
                    del left[episode.index]
                    yield episode.index, partial(self._record, episode=episode)
            except CorruptEpisode as err:
                for index in left:
                    leave_out(f"Episode {index}", err, self.options)

    def _record(self, writer: DatasetWriter, episode: SourceEpisode) -> Iterator[int]:
        columns: list[StepColumn] = []
        for column in self.mapping.columns:
            numbers = episode.numbers(column.name, (column.parts.size,))
            parts = column.parts.slices
            columns += [StepColumn(feature=f, values=numbers[:, parts[f.key]]) for f in column.parts.features]
        texts: dict[str, list[str]] = {}
        for name, feature in self.mapping.labels.items():
            values, texts[feature.key] = numbered(episode.texts(name))
            columns.append(StepColumn(feature=feature, values=values))
        for name, feature in self.mapping.cameras.items():
            columns.append(StepColumn(feature=feature, values=episode.images(name, feature, self.readers)))
        has_tasks = "task_index" in episode.table.column_names
        tasks = list(dict.fromkeys(episode.texts("task_index") if has_tasks else []))
        origin, imported = self.provenance.get(episode.index), {"episode": episode.index, "tasks": tasks}
        if origin is not None:
            about = EpisodeAbout.of_provenance(origin, imported)
        else:
            words = next(filter(None, (*tasks[:1], self.options.instruction, writer.info.instruction)), "")
            has_success = SUCCESS in episode.table.column_names
            success = bool(np.any(episode.numbers(SUCCESS, (1,)))) if has_success else None
            about = EpisodeAbout(id=f"{episode.index:06d}", instruction=words, success=success, imported=imported)
        if texts:
            about = replace(about, outcome={**about.outcome, LABELS: texts})
        return record_steps(writer, len(episode.table), columns, about)


def _provenance(source: LeRobotSource) -> dict[int, dict[str, Any]]:
    """Return the origin of each episode, if this is our export, unchanged."""
    path = source.root / PROVENANCE_FILE
    if not source.ours or not path.is_file():
        return {}
    refuse_pointer(path)
    found: dict[int, dict[str, Any]] = {}
    for row in read_json_lines(path):
        if type(index := checked_provenance(row, path).get("episode_index")) is not int:
            raise CorruptEpisode(f"{path} is damaged: {row!r:.80} has no whole number episode_index.")
        found[index] = row
    return found if {index: row["rows"] - 1 for index, row in found.items()} == source.lengths else {}


def _info(source: LeRobotSource, mapping: FeatureMapping, options: ImportOptions) -> DatasetInfo:
    if not mapping.features:
        raise InvalidSetup(f"{source.root} has no column to import: {mapping.left_out}.")
    own = source.ours
    imported: dict[str, Any] = {
        "format": f"LeRobot {source.version}",
        "robot_type": source.info.get("robot_type"),
        "names": {name: about.get("names") for name, about in source.features.items()},
        "left_out": mapping.left_out,
        **({"dataset": own.get("dataset"), "setup": own.get("setup")} if own else {}),
    }
    setup = own.get("setup")
    meaning = {key: setup[key] for key in MEANING_OF_ACTIONS if key in setup} if isinstance(setup, dict) else {}
    words = [own.get("instruction"), options.instruction, *source.tasks.values()]
    return DatasetInfo(
        frequency=own.get("frequency", source.fps),
        features=mapping.features,
        setup={**meaning, "imported": imported},
        instruction=next((text for text in words if isinstance(text, str) and text), ""),
        jpeg_quality=options.jpeg_quality,
    )


def _carrying(source: LeRobotSource, chosen: Iterable[int], options: ImportOptions) -> set[str]:
    """Return which of LeRobot's own columns carry something: stamps off the grid, a task that changes."""
    names = [name for name in ("timestamp", "frame_index", "task_index") if name in source.features]
    found: set[str] = set()
    for path, numbers in source.files([*chosen]).items():
        try:
            for episode in source.episodes(path, numbers, names):
                values = {name: episode.numbers(name, ()) for name in names}
                if "task_index" in names and len(set(values["task_index"].tolist())) > 1:
                    found.add("task_index")
                if {"timestamp", "frame_index"} <= values.keys():
                    off = np.abs(values["timestamp"] - values["frame_index"] / source.fps)
                    if float(off.max(initial=0)) > _ON_GRID_S:
                        found.add("timestamp")
        except CorruptEpisode:
            if not options.allow_missing:
                raise
    return found
