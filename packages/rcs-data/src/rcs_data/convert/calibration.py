"""Stores camera matrices beside an export, since formats for training have no place for them.

`meta/calibration.json` has per episode and camera `intrinsics` (3, 3) [px] and `extrinsics` (4, 4), the camera's pose
in the robot's base in OpenCV axes (x right, y down, z forward) [m]. A matrix that changes within an episode, as that of
a camera on a gripper, is null there, and `per_frame` names a Parquet file with a row per frame, matrices row-major.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from rcs_data.content import flat_numbers
from rcs_data.errors import CorruptEpisode
from rcs_data.feature import Feature
from rcs_data.info import DatasetInfo
from rcs_data.parquet import opened_of_others
from rcs_data.reader import EpisodeRecord

CALIBRATION_FILE = "meta/calibration.json"
CONVENTION = "extrinsics: pose of the camera in the robot's base, 4 x 4, m, OpenCV axes; intrinsics: 3 x 3, px"

_MATRICES = ("intrinsics", "extrinsics")


def calibration_features(info: DatasetInfo, cameras: list[str]) -> dict[str, dict[str, Feature]]:
    """Return the features of matrices by camera and name; cameras without any are left out."""
    found: dict[str, dict[str, Feature]] = {}
    known = {feature.key: feature for feature in info.features}
    for camera in cameras:
        keys = {name: f"observation/frames/{camera}/{name}" for name in _MATRICES}
        features = {name: known[key] for name, key in keys.items() if key in known}
        if features:
            found[camera] = features
    return found


def write_episode_calibration(
    root: Path, episode: EpisodeRecord, index: int, features: dict[str, dict[str, Feature]]
) -> dict[str, Any]:
    """Return an episode's entry of `calibration.json`, and write a file of the matrices that change within it.

    Args:
        root: The folder of the export.
        episode: The episode; its last row is left out, as in the export.
        index: Its number among the exported ones.
        features: The matrices, as `calibration_features` returns them.

    Raises:
        CorruptEpisode: The episode is damaged.
    """
    cameras: dict[str, Any] = {}
    changing: dict[str, pa.Array] = {}
    for camera, matrices in features.items():
        entry: dict[str, Any] = dict.fromkeys(_MATRICES)
        for name, feature in matrices.items():
            values = episode.column(feature.key)[:-1]
            if (values == values[0]).all():
                entry[name] = values[0].tolist()
            else:
                changing[f"{camera}/{name}"] = _lists(values)
        cameras[camera] = entry
    per_frame = None
    if changing:
        per_frame = _per_frame(index)
        path = root / per_frame
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.table(changing), path, compression="zstd")
    return {"episode_index": index, "per_frame": per_frame, "cameras": cameras}


def read_episode_calibration(
    root: Path, entry: dict[str, Any], features: dict[str, dict[str, Feature]], steps: int
) -> dict[str, NDArray[Any]]:
    """Return the matrices of an episode by key, each of shape (steps, n, n).

    Args:
        root: The folder of the export.
        entry: The episode's entry of `calibration.json`.
        features: The matrices, as `calibration_features` returned them.
        steps: Number of rows.

    Raises:
        CorruptEpisode: The entry or its file is damaged.
    """
    values: dict[str, NDArray[Any]] = {}
    try:
        index = int(entry["episode_index"])
        table = pa.table({})
        if entry["per_frame"]:
            with opened_of_others(root / _per_frame(index)) as source:
                table = source.table()
        for camera, matrices in features.items():
            for name, feature in matrices.items():
                constant = entry["cameras"][camera][name]
                if constant is not None:
                    values[feature.key] = np.broadcast_to(np.array(constant, feature.dtype), (steps, *feature.shape))
                else:
                    flat = flat_numbers(table.column(f"{camera}/{name}"))
                    values[feature.key] = flat.reshape(steps, *feature.shape).astype(feature.dtype)
    except (KeyError, TypeError, ValueError, OSError, pa.ArrowException) as err:
        raise CorruptEpisode(f"The camera matrices in {root} are damaged: {err!r}.") from err
    return values


def _per_frame(index: int) -> str:
    return f"rcs/calibration/chunk-{index // 1000:03d}/episode_{index:06d}.parquet"


def _lists(values: NDArray[Any]) -> pa.Array:
    flat = np.ascontiguousarray(values).reshape(len(values), -1)
    return pa.FixedSizeListArray.from_arrays(pa.array(flat.reshape(-1)), flat.shape[1])
