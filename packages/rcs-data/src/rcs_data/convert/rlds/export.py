"""Exports to RLDS, as a folder for TensorFlow Datasets; Octo and OpenVLA train on it.

`<out>/<name>/1.0.0` has `dataset_info.json`, `features.json` and the episodes in TFRecord files, so that
`tfds.builder_from_directory` or, with `data_dir=<out>`, `tfds.builder(<name>)` opens it. A step has

- `observation`: `state` (float32), every part of the observation under its own name (`joints`, `left_gripper`),
  `image_<camera>`, `depth_<camera>` [mm], `intrinsics_<camera>`, `extrinsics_<camera>`; `recorded_state` is a part
  that is named `state` itself, where it is not all of it;
- `action` (float32), `reward` (float32), `discount` (0 where the step ended the task, else 1), `is_first`, `is_last`,
  `is_terminal`, `language_instruction`.

As in the datasets of Open X-Embodiment, the last step has an action, and the observation after it is left out. JPEGs
are copied without compressing them again; losslessly recorded images become PNG. `rcs.json` beside the episodes has
what an import needs: the feature of each column, names and units of the numbers of state and action, and the rate.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.convert.images import as_png
from rcs_data.convert.observations import (
    describe_layout,
    export_report,
    is_done,
    kept_info,
    named,
    observed,
    short_name,
)
from rcs_data.convert.options import ExportOptions, ExportReport, export_name, refuse_unused, selected_episodes
from rcs_data.convert.provenance import episode_provenance
from rcs_data.convert.rlds.features import Spec, features_json, image, numbers, tensor, text
from rcs_data.convert.rlds.tfrecord import ShardWriter, Values
from rcs_data.errors import InvalidSetup
from rcs_data.files.feature import Feature
from rcs_data.files.info import DatasetInfo
from rcs_data.files.output import new_output
from rcs_data.read.reader import Dataset, EpisodeRecord
from rcs_data.read.trajectory import Trajectory, VectorLayout, action_layout, state_layout, trajectory

VERSION = "1.0.0"
SPLIT = "train"
RCS_FILE = "rcs.json"
_STATE = "observation/state"


@dataclass(frozen=True)
class _Source:
    """An episode, for the columns to read."""

    episode: EpisodeRecord
    steps: Trajectory
    provenance: dict[str, Any]


@dataclass(frozen=True)
class _Column:
    spec: Spec
    values: Callable[[_Source], Values]
    key: str | None = None
    """The feature that it is, if it is one."""


def export_rlds(dataset: Dataset, out: str | Path, options: ExportOptions | None = None) -> ExportReport:
    """Export episodes as RLDS.

    Args:
        dataset: The dataset.
        out: The folder for a folder of the export's name; it may have others already.
        options: Episodes, cameras and features; `extra` adds features that are not observations, such as
            "executed/joints". `shard_mb` limits the files.

    Raises:
        InvalidSetup: An option does not suit the dataset, nothing is left to export, or an episode is 2 GiB or more.
        CorruptEpisode: An episode is damaged.
        DatasetError: An export of that name exists, or the disk fails.
    """
    options = options or ExportOptions()
    refuse_unused(options, "RLDS", ("state", "action", "extra", "name", "shard_mb"))
    episodes = selected_episodes(dataset, options)
    info = kept_info(dataset.info, options)
    state, action = state_layout(info, options.state), action_layout(info, options.action)
    columns = _columns(dataset, info, state, action, options)
    name = export_name(dataset, options)
    digest = dataset.digest()
    total = sum(episode.length - 1 for episode in episodes)
    done = 0
    target = Path(out) / name
    with new_output(target) as partial:
        folder = partial / VERSION
        folder.mkdir(parents=True)
        shards = ShardWriter(folder, f"{name}-{SPLIT}.tfrecord", options.shard_mb * 1_000_000)
        for episode in episodes:
            steps = trajectory(episode, state, action)
            source = _Source(episode, steps, episode_provenance(episode, digest))
            shards.write({path: column.values(source) for path, column in columns.items()})
            done += len(steps)
            if options.on_progress is not None:
                options.on_progress(done, total)
        shards.close()
        _write_json(folder / "features.json", features_json({path: column.spec for path, column in columns.items()}))
        _write_json(folder / "dataset_info.json", _dataset_info(name, info.instruction, shards))
        about = {
            "dataset": digest,
            "state": describe_layout(state),
            "action": describe_layout(action),
            "columns": {path: column.key for path, column in columns.items() if column.key is not None},
            "info": info.to_json(),
        }
        _write_json(folder / RCS_FILE, about)
    images = sum(1 for column in columns.values() if "image" in column.spec)
    narrowed = any(feature.dtype == "float64" for feature in observed(info))
    notes = ("64-bit numbers became float32, the only float type of the format.",) if narrowed else ()
    return export_report(target / VERSION, dataset, options, episodes, images * total, notes)


def _columns(
    dataset: Dataset, info: DatasetInfo, state: VectorLayout, action: VectorLayout, options: ExportOptions
) -> dict[str, _Column]:
    seen, own = observed(info), None
    if [feature.key for feature in state.features] == [_STATE]:
        own = _STATE
        seen = tuple(feature for feature in seen if feature.key != own)  # already the state
    extra = [info.feature(key) for key in options.extra]
    images = [feature.key for feature in extra if feature.is_image]
    if images:
        raise InvalidSetup(
            f"{', '.join(images)} cannot be extra features, which must be numbers; choose cameras instead."
        )
    observations = named(seen, lambda f: "recorded_state" if f.key == _STATE else short_name(f, "{kind}_{camera}"))
    reward = "reward" if any(feature.key == "reward" for feature in info.features) else None
    columns = {
        _STATE: _Column(tensor((state.size,), "float32"), lambda s: s.steps.states.astype(np.float32), own),
        **{f"observation/{name}": _feature_column(feature) for name, feature in observations.items()},
    }
    usual = {
        "action": _Column(tensor((action.size,), "float32"), lambda s: s.steps.actions.astype(np.float32)),
        "reward": _Column(tensor((), "float32"), lambda s: s.steps.rewards.astype(np.float32), reward),
        "discount": _Column(tensor((), "float32"), lambda s: (~s.steps.terminated).astype(np.float32)),
        "is_first": _Column(tensor((), "bool"), lambda s: _only(0, len(s.steps))),
        "is_last": _Column(tensor((), "bool"), lambda s: _only(len(s.steps) - 1, len(s.steps))),
        "is_terminal": _Column(tensor((), "bool"), lambda s: s.steps.terminated.astype(np.int64)),
        "language_instruction": _Column(text(), lambda s: [s.episode.instruction.encode()] * len(s.steps)),
    }
    rest = [feature for feature in extra if feature not in seen]
    others = named(rest, lambda f: f.key.replace("/", "_"), taken=("observation", *usual))
    columns |= {name: _feature_column(feature) for name, feature in others.items()} | usual
    about = {
        "file_path": _Column(text(), lambda s: [f"{dataset.path.name}/{s.episode.id}".encode()]),
        "episode_id": _Column(text(), lambda s: [s.episode.id.encode()]),
        "seed": _Column(tensor((), "int64"), lambda s: _integer(s.episode.seed)),
        "success": _Column(tensor((), "int64"), lambda s: _integer(s.episode.success)),
        "dataset_digest": _Column(text(), lambda s: [s.provenance["dataset"].encode()]),
        "provenance": _Column(text(), lambda s: [json.dumps(s.provenance, ensure_ascii=False).encode()]),
    }
    return {
        **{f"steps/{name}": column for name, column in columns.items()},
        **{f"episode_metadata/{name}": column for name, column in about.items()},
    }


def _feature_column(feature: Feature) -> _Column:
    if feature.is_image:
        return _Column(image(feature), lambda s: _encoded(s.episode, feature), feature.key)
    return _Column(numbers(feature), lambda s: _numbers(s.episode, feature), feature.key)


def _encoded(episode: EpisodeRecord, feature: Feature) -> Iterator[bytes]:
    last, encoded = None, b""
    for data in islice(episode.encoded_frames(feature.key), episode.length - 1):
        if data is not last:
            last = data
            encoded = data if feature.encoding == "jpeg" else as_png(feature, data)
        yield encoded


def _numbers(episode: EpisodeRecord, feature: Feature) -> Values:
    """Return a column by step: the observation before it, or what it did; shape (steps, *shape)."""
    column = episode.column(feature.key)
    values = column[1:] if is_done(feature) else column[:-1]
    if values.dtype.kind == "f":
        return values.astype(np.float32)
    # As in TensorFlow Datasets, the upper half of uint64 becomes negative.
    return values.view(np.int64) if values.dtype == np.uint64 else values.astype(np.int64)


def _only(index: int, length: int) -> NDArray[np.int64]:
    return (np.arange(length) == index).astype(np.int64)


def _integer(value: int | None) -> NDArray[np.int64]:
    """Return one number; -1 if unknown or too large (`provenance` has the original)."""
    return np.array([value if value is not None and abs(value) < 1 << 63 else -1], np.int64)


def _dataset_info(name: str, description: str, shards: ShardWriter) -> dict[str, Any]:
    split = {
        "name": SPLIT,
        "filepathTemplate": "{DATASET}-{SPLIT}.{FILEFORMAT}-{SHARD_X_OF_Y}",
        "numBytes": str(shards.data_bytes),
        "shardLengths": [str(length) for length in shards.shard_lengths],
    }
    return {"name": name, "version": VERSION, "description": description, "fileFormat": "tfrecord", "splits": [split]}


def _write_json(path: Path, values: dict[str, Any]) -> None:
    path.write_text(json.dumps(values, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
