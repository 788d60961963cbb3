"""Imports a LeRobotDataset, v2.0, v2.1 or v3.0, whether exported by RCS or not.

T frames become T + 1 rows: row i has the observation of frame i, row i + 1 its action. LeRobot does not keep the
observation after the last frame. Our exports have it beside the frames, which restores every row. In other datasets,
row T repeats the observation of row T - 1, and `imported.last_observation` in the episode's outcome is "repeated".
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rcs_data.codec import decode_frame
from rcs_data.content import flat_numbers
from rcs_data.convert.calibration import CALIBRATION_FILE, read_episode_calibration
from rcs_data.convert.lerobot import depth_path
from rcs_data.convert.lerobot_layout import LAST_ROWS_FILE, PROVENANCE_FILE, RCS_FILE, SUCCESS
from rcs_data.convert.lerobot_mapping import FeatureMapping, feature_mapping
from rcs_data.convert.lerobot_source import LeRobotSource, SourceEpisode
from rcs_data.convert.options import ImportOptions, stored_as
from rcs_data.convert.provenance import by_episode, checked_provenance
from rcs_data.convert.video import VideoReader, decode_depth_video
from rcs_data.errors import CorruptEpisode, InvalidSetup
from rcs_data.feature import Feature
from rcs_data.info import DatasetInfo
from rcs_data.json_file import read_json, read_json_lines
from rcs_data.layout import check_episode_id
from rcs_data.output import new_output
from rcs_data.parquet import opened_of_others
from rcs_data.reader import Dataset
from rcs_data.writer import DatasetWriter

# LeRobot's own tolerance between a stamp and frame / fps is 1e-4 s.
_ON_GRID_S = 1e-4


def is_lerobot(source: Path) -> bool:
    """Return whether a folder looks like a LeRobotDataset."""
    return (source / "meta" / "info.json").is_file()


def import_lerobot(source: str | Path, out: str | Path, options: ImportOptions | None = None) -> Dataset:
    """Import a LeRobotDataset, whole or not at all.

    Numbers keep the source's dtype, which is float32 for vectors of our exports. Images are compressed again. Success
    is known only if the source has `next.success` or is our export.

    Args:
        source: The folder of the LeRobotDataset.
        out: The folder to make.
        options: How images are stored.

    Raises:
        DatasetError: There is no such dataset, `out` exists, or the disk fails.
        CorruptEpisode: The source is damaged.
        InvalidSetup: The source has nothing to import.
    """
    options = options or ImportOptions()
    given = LeRobotSource(Path(source))
    ours = read_json(given.root / RCS_FILE) if (given.root / RCS_FILE).is_file() else None
    mapping = feature_mapping(given, ours, keeps_timestamp=not _is_on_grid(given))
    beside = _Beside.of(given, ours, mapping)
    with new_output(out) as folder:
        readers: dict[str, VideoReader] = {}
        done = 0
        try:
            with DatasetWriter.open(folder, _info(given, ours, mapping, options)) as writer:
                for episode in given.episodes():
                    _import(episode, writer, given, mapping, beside, readers, options)
                    done += len(episode.table)
                    if options.on_progress:
                        options.on_progress(done, given.frames)
        finally:
            for reader in readers.values():
                reader.close()
    return Dataset.open(out)


@dataclass(frozen=True, kw_only=True)
class _Beside:
    """The files that our exports have beside LeRobot's; empty for other datasets."""

    root: Path
    provenance: dict[int, dict[str, Any]]
    calibration: dict[int, dict[str, Any]]
    has_last_rows: bool

    @classmethod
    def of(cls, source: LeRobotSource, ours: Mapping[str, Any] | None, mapping: FeatureMapping) -> _Beside:
        provenance: dict[int, dict[str, Any]] = {}
        calibration: dict[int, dict[str, Any]] = {}
        path = source.root / PROVENANCE_FILE
        if ours is not None and path.is_file():
            rows = [checked_provenance(row, path) for row in read_json_lines(path)]
            provenance = by_episode(rows, path)
        # If episodes were added or removed since, these files no longer fit.
        if {index: row["rows"] - 1 for index, row in provenance.items()} != source.lengths:
            if mapping.depths or mapping.matrices:
                raise CorruptEpisode(
                    f"{source.root} was exported by RCS and changed since: {PROVENANCE_FILE} lists other "
                    f"episodes than LeRobot's files. Remove {RCS_FILE} to import it like any other LeRobot dataset."
                )
            return cls(root=source.root, provenance={}, calibration={}, has_last_rows=False)
        if mapping.matrices:
            path = source.root / CALIBRATION_FILE
            calibration = by_episode(read_json(path).get("episodes", []), path)
        has_last_rows = (source.root / LAST_ROWS_FILE).is_file()
        return cls(root=source.root, provenance=provenance, calibration=calibration, has_last_rows=has_last_rows)

    def last_row(self, index: int, features: tuple[Feature, ...]) -> dict[str, Any]:
        """Return the last observation of an episode by key; empty if it was not stored."""
        if not self.has_last_rows:
            return {}
        path = self.root / LAST_ROWS_FILE
        with opened_of_others(path) as source:
            if not 0 <= index < source.file.num_row_groups:
                raise CorruptEpisode(f"{path} has {source.file.num_row_groups} groups, but none for episode {index}.")
            table = source.table(groups=[index])
        row: dict[str, Any] = {}
        for feature in features:
            if feature.key in table.column_names:
                column = table.column(feature.key)
                if len(column) != 1 or column.type != feature.arrow_type or column.null_count:
                    raise CorruptEpisode(f"{path} has {len(column)} rows of {column.type} as {feature.key!r}.")
                row[feature.key] = (
                    decode_frame(feature, column[0].as_py())
                    if feature.is_image
                    else flat_numbers(column).reshape(1, *feature.shape)[0]
                )
        return row


def _import(
    episode: SourceEpisode,
    writer: DatasetWriter,
    source: LeRobotSource,
    mapping: FeatureMapping,
    beside: _Beside,
    readers: dict[str, VideoReader],
    options: ImportOptions,
) -> None:
    steps = len(episode.table)
    seen, done = _numbers(episode, mapping)
    if mapping.matrices:
        entry = beside.calibration.get(episode.index, {})
        seen |= read_episode_calibration(beside.root, entry, mapping.matrices, steps)
    images: dict[str, Iterator[NDArray[Any]]] = {
        feature.key: episode.images(name, feature.shape, readers, source.fps)
        for name, feature in mapping.cameras.items()
    }
    for camera, feature in mapping.depths.items():
        images[feature.key] = decode_depth_video(beside.root / depth_path(camera, episode.index))
    last = beside.last_row(episode.index, mapping.features)
    came = beside.provenance.get(episode.index, {})
    instruction = came.get("instruction") or " ".join(episode.tasks[:1]) or options.instruction
    current: dict[str, Any] = {}
    with writer.episode(_name(episode, came), seed=came.get("seed"), instruction=instruction) as taken:
        for row in range(steps + 1):
            values = {key: column[row - 1] for key, column in done.items()} if row else {}
            if row < steps:
                current = {key: column[row] for key, column in seen.items()}
                current |= {key: _next(frames, key, episode) for key, frames in images.items()}
                taken.add(_timed(values | current))
            else:
                # Unmeasured times are not set.
                repeated = {key: None if key.startswith("time/") else value for key, value in current.items()}
                taken.add(_timed(values | repeated | last))
        about = {
            "episode": episode.index,
            "tasks": list(episode.tasks),
            "last_observation": "kept" if last else "repeated",
            **({"provenance": came} if came else {}),
        }
        taken.finish(_success(episode, came), {**came.get("outcome", {}), "imported": about})


def _numbers(episode: SourceEpisode, mapping: FeatureMapping) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the columns of numbers by feature: of observations, and of what each step did."""
    seen: dict[str, Any] = {}
    done: dict[str, Any] = {}
    for column in mapping.columns:
        numbers = episode.numbers(column.name, (column.parts.size,))
        for feature in column.parts.features:
            part = numbers[:, column.parts.slices[feature.key]].reshape(-1, *feature.shape)
            (done if column.is_after else seen)[feature.key] = part.astype(feature.dtype, copy=False)
    return seen, done


def _timed(row: dict[str, Any]) -> dict[str, Any]:
    return {
        key: None if key.startswith("time/") and value is not None and not math.isfinite(value) else value
        for key, value in row.items()
    }


def _next(frames: Iterator[NDArray[Any]], key: str, episode: SourceEpisode) -> NDArray[Any]:
    frame = next(frames, None)
    if frame is None:
        raise CorruptEpisode(f"Episode {episode.index} has fewer images of {key!r} than rows.")
    return frame


def _name(episode: SourceEpisode, came: Mapping[str, Any]) -> str:
    name = str(came.get("episode", f"{episode.index:06d}"))
    check_episode_id(name)
    return name


def _success(episode: SourceEpisode, came: Mapping[str, Any]) -> bool | None:
    if came:
        return came["success"]
    if SUCCESS in episode.table.column_names:
        return bool(np.any(episode.numbers(SUCCESS, (1,))))
    return None


def _info(
    source: LeRobotSource, ours: Mapping[str, Any] | None, mapping: FeatureMapping, options: ImportOptions
) -> DatasetInfo:
    if not mapping.features:
        raise InvalidSetup(f"{source.root} has no column to import: {mapping.left_out}.")
    imported: dict[str, Any] = {
        "format": f"LeRobot {source.version}",
        "robot_type": source.info.get("robot_type"),
        "names": {name: about.get("names") for name, about in source.features.items()},
        "left_out": mapping.left_out,
    }
    own = ours or {}
    if own:
        imported |= {"dataset": own.get("dataset"), "setup": own.get("setup")}
    words = chain([own.get("instruction"), options.instruction], source.tasks.values())
    return DatasetInfo(
        frequency=own.get("frequency", source.fps),
        features=tuple(stored_as(feature, options) for feature in mapping.features),
        setup={"imported": imported},
        instruction=next((text for text in words if isinstance(text, str) and text), ""),
        jpeg_quality=options.jpeg_quality,
    )


def _is_on_grid(source: LeRobotSource) -> bool:
    """Return whether all stamps equal frame number over rate, and so carry no information."""
    if "timestamp" not in source.features or "frame_index" not in source.features:
        return True
    for path in sorted((source.root / "data").glob("*/*.parquet")):
        with opened_of_others(path) as opened:
            table = opened.table(["timestamp", "frame_index"])
        if table.num_columns < 2:
            raise CorruptEpisode(f"{path} lacks the column timestamp or frame_index listed in info.json.")
        if not all(pa.types.is_integer(kind) or pa.types.is_floating(kind) for kind in table.schema.types):
            raise CorruptEpisode(f"{path} has {table.schema.types} as timestamp and frame_index; expected numbers.")
        off = table.column("timestamp").to_numpy() - table.column("frame_index").to_numpy() / source.fps
        if len(off) and float(np.abs(off).max()) > _ON_GRID_S:
            return False
    return True
