"""Maps the features of a dataset to the columns of a LeRobot dataset, for both versions.

A frame of LeRobot is a step: an observation and the action that followed. Besides LeRobot's own columns, there is one
for each time and each camera's flags, such as "time.monotonic" and "simulated_time", since `timestamp` is by definition
frame / fps. Columns that begin with "observation" become inputs of LeRobot's policies, so only the state and the images
are exported by default. Camera matrices are columns too, `calibration.<camera>.intrinsics` [px] and `.extrinsics`, the
camera's pose in the robot's base in OpenCV axes (x right, y down, z forward) [m], row-major. Texts per row, as
`rcs_data.convert.labels` has them, are columns of strings, and `extra/task_index` becomes LeRobot's own.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rcs_data.convert.labels import labels, row_texts
from rcs_data.convert.lerobot.video import pixel_format
from rcs_data.convert.observations import is_done
from rcs_data.convert.options import ExportOptions, VideoCodec, selected_cameras
from rcs_data.errors import InvalidSetup
from rcs_data.files.feature import Feature
from rcs_data.files.info import DatasetInfo
from rcs_data.read.reader import EpisodeRecord
from rcs_data.read.trajectory import VectorLayout, action_layout, camera_features, state_layout

STATE, ACTION, IMAGES = "observation.state", "action", "observation.images."
REWARD, DONE, SUCCESS = "next.reward", "next.done", "next.success"
TERMINATED, TRUNCATED = "next.terminated", "next.truncated"
RCS_FILE = "meta/rcs.json"
PROVENANCE_FILE = "meta/rcs_provenance.jsonl"
TASK, SUBTASK = "extra/task_index", "extra/subtask_index"
"""Features with texts per row that LeRobot has tables for."""

TEXT = "string"
"""LeRobot's dtype of texts."""

INDICES = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""Columns that LeRobot adds to each frame."""


@dataclass(frozen=True, kw_only=True)
class Column:
    """A column of numbers and the features that make it up."""

    name: str
    """Its name in LeRobot."""
    dtype: str
    """Its dtype."""
    parts: VectorLayout
    """The features, joined in this order."""

    @property
    def is_after(self) -> bool:
        """Whether it describes what a step did, not the observation before."""
        return all(is_done(feature) for feature in self.parts.features)

    def to_json(self) -> dict[str, Any]:
        """Return what an import needs, as JSON values."""
        return {"name": self.name, "features": [feature.to_json() for feature in self.parts.features]}


@dataclass(frozen=True, kw_only=True)
class LeRobotLayout:
    """The columns and videos of an export."""

    fps: int
    """Frames per second."""
    codec: VideoCodec
    """How videos are compressed."""
    columns: tuple[Column, ...]
    """Columns made of features, the state first and the action second."""
    cameras: dict[str, Feature]
    """Colour images by column."""
    has_success: bool
    """Whether every episode has a verdict."""
    tables: tuple[str, ...] = ()
    """`TASK` and `SUBTASK` where the dataset has them."""

    @property
    def numbers(self) -> dict[str, tuple[str, int]]:
        """Dtype and size of every column in the Parquet files, in order."""
        sizes = {column.name: (column.dtype, column.parts.size) for column in self.columns}
        flags = [DONE, SUCCESS] if self.has_success else [DONE]
        indices = {**INDICES, "subtask_index": "int64"} if SUBTASK in self.tables else INDICES
        return sizes | dict.fromkeys(flags, ("bool", 1)) | {name: (dtype, 1) for name, dtype in indices.items()}

    def features(self) -> dict[str, Any]:
        """Return the features as in `info.json`."""
        names = {column.name: list(column.parts.names) for column in self.columns if column.name in (STATE, ACTION)}
        found: dict[str, Any] = {
            name: {"dtype": dtype, "shape": [size], "names": names.get(name)}
            for name, (dtype, size) in self.numbers.items()
        }
        videos = {name: self._video(feature) for name, feature in self.cameras.items()}
        return {STATE: found.pop(STATE), ACTION: found.pop(ACTION), **videos, **found}

    def _video(self, feature: Feature) -> dict[str, Any]:
        height, width, _ = feature.shape
        about = {
            "video.height": height,
            "video.width": width,
            "video.codec": self.codec,
            "video.pix_fmt": pixel_format(height, width, self.codec),
            "video.is_depth_map": False,
            "video.fps": self.fps,
            "video.channels": 3,
            "has_audio": False,
        }
        return {"dtype": "video", "shape": list(feature.shape), "names": ["height", "width", "channels"], "info": about}

    @cached_property
    def schema(self) -> pa.Schema:
        """The schema of the Parquet files, with the features in the metadata of the `datasets` package."""
        fields: list[pa.Field] = []
        described: dict[str, Any] = {}
        for name, (dtype, size) in self.numbers.items():
            number = pa.string() if dtype == TEXT else pa.from_numpy_dtype(np.dtype(dtype))
            fields.append(pa.field(name, number if size == 1 else pa.list_(number, size)))
            value = {"dtype": dtype, "_type": "Value"}
            # "Sequence", not "List": the versions of `datasets` that read v2.1 do not know the latter.
            described[name] = value if size == 1 else {"feature": value, "length": size, "_type": "Sequence"}
        return pa.schema(fields, metadata={"huggingface": json.dumps({"info": {"features": described}})})

    def arrays(
        self, episode: EpisodeRecord, *, index: int, first: int, texts: Mapping[str, NDArray[Any]]
    ) -> dict[str, NDArray[Any]]:
        """Return the columns of an episode, each of shape (steps, size).

        Args:
            episode: The episode; CorruptEpisode if it is damaged.
            index: Its number among the exported ones.
            first: The number of its first frame in the dataset.
            texts: `task_index` and, if there are any, `subtask_index`, shape (steps,).
        """
        steps = episode.length - 1
        arrays = {c.name: _values(c, episode) for c in self.columns}
        ends = [arrays[name].reshape(steps) for name in (TERMINATED, TRUNCATED) if name in arrays]
        # The recording ends with its last step, for whatever reason.
        arrays[DONE] = np.any([np.arange(steps) == steps - 1, *ends], axis=0)
        if self.has_success:
            arrays[SUCCESS] = np.arange(steps) == (steps - 1 if episode.success else steps)
        arrays |= {
            "timestamp": np.arange(steps) / self.fps,
            "frame_index": np.arange(steps),
            "episode_index": np.full(steps, index),
            "index": np.arange(first, first + steps),
            **texts,
        }
        return {
            name: np.ascontiguousarray(arrays[name].reshape(steps, size), object if dtype == TEXT else dtype)
            for name, (dtype, size) in self.numbers.items()
        }

    def table(self, arrays: dict[str, NDArray[Any]]) -> pa.Table:
        """Return the columns as a table for a Parquet file."""
        schema = self.schema
        made: list[pa.Array] = []
        for field in schema:
            values = pa.array(arrays[field.name].reshape(-1), *([field.type] if pa.types.is_string(field.type) else []))
            is_list = pa.types.is_fixed_size_list(field.type)
            made.append(pa.FixedSizeListArray.from_arrays(values, field.type.list_size) if is_list else values)
        return pa.Table.from_arrays(made, schema=schema)


def lerobot_layout(info: DatasetInfo, episodes: Sequence[EpisodeRecord], options: ExportOptions) -> LeRobotLayout:
    """Choose the columns and videos of an export of these episodes.

    Raises:
        InvalidSetup: The rate is not a whole number, a feature or camera is unknown, or the codec does not support its
            images.
        CorruptEpisode: An episode's description is damaged.
    """
    cameras = camera_features(info)
    chosen = selected_cameras(cameras, options)
    layout = LeRobotLayout(
        fps=_whole_rate(info, options),
        codec=options.codec,
        columns=_columns(info, options, chosen, episodes),
        cameras={IMAGES + name.replace("/", "."): cameras[name] for name in chosen},
        has_success=all(episode.success is not None for episode in episodes),
        tables=tuple(key for key in (TASK, SUBTASK) if _is_text(info, episodes, key)),
    )
    for feature in layout.cameras.values():
        pixel_format(feature.shape[0], feature.shape[1], options.codec)
    return layout


def _columns(
    info: DatasetInfo, options: ExportOptions, cameras: Sequence[str], episodes: Sequence[EpisodeRecord]
) -> tuple[Column, ...]:
    action = action_layout(info, options.action)
    if before := [feature.key for feature in action.features if not is_done(feature)]:
        raise InvalidSetup(
            f"The action has {', '.join(before)}, measured before the step, so it would say nothing about it; valid "
            "are features of steps, such as those of action/ and executed/."
        )
    columns = [
        Column(name=STATE, dtype="float32", parts=state_layout(info, options.state)),
        Column(name=ACTION, dtype="float32", parts=action),
    ]
    singles = {
        "reward": (REWARD, "float32"), "terminated": (TERMINATED, "bool"), "truncated": (TRUNCATED, "bool")
    }  # fmt: skip
    known = {feature.key: feature for feature in info.features}
    columns += [single_column(known[key], name, dtype) for key, (name, dtype) in singles.items() if key in known]
    for camera in cameras:
        for kind in ("intrinsics", "extrinsics"):
            key = f"observation/frames/{camera}/{kind}"
            if key in known:
                columns.append(single_column(known[key], f"calibration.{camera.replace('/', '.')}.{kind}"))
    extra = [info.feature(key) for key in options.extra]
    extra += [f for f in info.features if (f.is_circumstance or f.is_time) and f not in extra]
    for feature in extra:
        if feature.is_image or feature.key in singles:
            raise InvalidSetup(f"{feature.key!r} cannot be a column: choose features of numbers.")
        plain = feature.key.removeprefix("extra/")
        name = feature.key if plain in (*INDICES, REWARD, DONE, SUCCESS, TERMINATED, TRUNCATED) else plain
        columns.append(
            single_column(feature, name.replace("/", "."), TEXT if _is_text(info, episodes, feature.key) else None)
        )
    names = [column.name for column in columns]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InvalidSetup(f"Several features would become the column {', '.join(twice)}; leave some out.")
    return tuple(columns)


def single_column(feature: Feature, name: str, dtype: str | None = None) -> Column:
    """Return the column of one feature, in its own dtype unless another is given."""
    return Column(name=name, dtype=dtype or feature.dtype, parts=VectorLayout(features=(feature,)))


def _is_text(info: DatasetInfo, episodes: Sequence[EpisodeRecord], key: str) -> bool:
    return any(feature.key == key for feature in info.features) and all(key in labels(e) for e in episodes)


def _values(column: Column, episode: EpisodeRecord) -> NDArray[Any]:
    features = column.parts.features
    if column.dtype == TEXT:
        return np.array(row_texts(episode, next(f.key for f in features))[:-1], object)
    # A single feature keeps its dtype; joined ones become float64, which cannot hold every 64-bit integer.
    rows = column.parts.rows(episode) if len(features) > 1 else episode.column(next(f.key for f in features))
    return rows[1:] if column.is_after else rows[:-1]


def _whole_rate(info: DatasetInfo, options: ExportOptions) -> int:
    rate = options.fps or info.frequency
    if rate == round(rate):
        return round(rate)
    near = max(1, round(rate))
    raise InvalidSetup(
        f"LeRobot needs a whole number of frames per second; this dataset has {rate:g}. Resample it, or claim "
        f"fps={near}: times are then off by {abs(rate / near - 1):.2%}, and {RCS_FILE} keeps the true rate."
    )
