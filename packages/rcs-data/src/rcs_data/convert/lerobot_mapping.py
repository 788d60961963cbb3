"""Maps the columns of a LeRobotDataset to features.

Our exports list their features in `meta/rcs.json`, which restores their names. In other datasets

- `observation.state` becomes `observation/state`, and so on for all columns that begin with "observation";
- `action` becomes `action/action`, and so on for all columns that begin with "action";
- `next.reward` becomes `reward`;
- a video or image becomes `observation/frames/<camera>/rgb`, where <camera> is its name without "observation.images.";
- all other columns of numbers become `extra/<name>`: `next.done` too, since it does not distinguish the end of a task
from that of a recording.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from rcs_data.convert.lerobot_layout import DONE, INDICES, RCS_FILE, REWARD, SUCCESS, Column
from rcs_data.convert.lerobot_source import LeRobotSource
from rcs_data.errors import CorruptEpisode
from rcs_data.feature import DTYPES, Feature
from rcs_data.layout import is_name
from rcs_data.trajectory import VectorLayout

Matrices = dict[str, dict[str, Feature]]


@dataclass(frozen=True, kw_only=True)
class FeatureMapping:
    """The features of a LeRobot dataset's columns."""

    columns: tuple[Column, ...]
    """Columns of numbers."""
    cameras: dict[str, Feature]
    """Columns of images."""
    depths: dict[str, Feature]
    """Cameras with depth images beside the export, if it is ours."""
    matrices: Matrices
    """Camera matrices beside the export, if it is ours."""
    features: tuple[Feature, ...]
    """All features, in the order of the new dataset."""
    left_out: dict[str, str]
    """Columns that are left out, with the reason."""


def feature_mapping(source: LeRobotSource, ours: Mapping[str, Any] | None, *, keeps_timestamp: bool) -> FeatureMapping:
    """Choose the features.

    Args:
        source: The LeRobot dataset.
        ours: The contents of `meta/rcs.json`; None if there is no such file.
        keeps_timestamp: Whether `timestamp` carries more than frame number over rate.
    """
    columns, cameras, depths, matrices = _own(source, ours or {})
    known = {*(column.name for column in columns), *cameras, *({DONE, SUCCESS} if ours else ())}
    left_out: dict[str, str] = {}
    for name, about in source.features.items():
        if name in known or (name in INDICES and not (name == "timestamp" and keeps_timestamp)):
            continue
        dtype = str(about["dtype"])
        shape = tuple(int(n) for n in about["shape"])
        info = about.get("info") or about.get("video_info")
        info = info if isinstance(info, dict) else {}
        if dtype in ("video", "image"):
            if len(shape) != 3:
                left_out[name] = f"its images have the shape {shape}"
                continue
            height, width, channels = _sizes(shape, about.get("names"))
            if info.get("video.is_depth_map") or info.get("is_depth_map") or channels != 3:
                left_out[name] = "its images are not RGB"
                continue
            key = f"observation/frames/{camera_name(name)}/rgb"
            cameras[name] = Feature(key=key, shape=(height, width, 3), dtype="uint8", encoding="jpeg")
        elif name == "timestamp":
            columns.append(_single(name, Feature(key="time/timestamp", shape=(), dtype="float64", unit="s")))
        elif dtype not in DTYPES and dtype != "float16":
            left_out[name] = f"{dtype} is not numeric"
        else:
            columns.append(_single(name, _feature(name, shape, "float32" if dtype == "float16" else dtype)))
    parts = [f for column in columns for f in column.parts.features]
    parts += [*cameras.values(), *depths.values(), *(f for m in matrices.values() for f in m.values())]
    order = (ours or {}).get("order", [])
    if not isinstance(order, list):
        raise CorruptEpisode(f"{source.root / RCS_FILE} is damaged: its order is {order!r:.80}.")
    features = sorted(parts, key=lambda f: order.index(f.key) if f.key in order else len(order))
    return FeatureMapping(
        columns=tuple(columns),
        cameras=cameras,
        depths=depths,
        matrices=matrices,
        features=tuple(features),
        left_out=left_out,
    )


def camera_name(column: str) -> str:
    """Return the camera of a column: "wrist" of "observation.images.wrist", "image" of "observation.image"."""
    for prefix in ("observation.images.", "observation."):
        if column.startswith(prefix):
            return column.removeprefix(prefix)
    return column


def _own(
    source: LeRobotSource, ours: Mapping[str, Any]
) -> tuple[list[Column], dict[str, Feature], dict[str, Feature], Matrices]:
    try:
        columns = [
            Column(
                name=column["name"],
                dtype=source.features[column["name"]]["dtype"],
                parts=VectorLayout(features=tuple(Feature.from_json(f) for f in column["features"])),
            )
            for column in ours.get("columns", ())
            if column["name"] in source.features
        ]
        cameras = {n: Feature.from_json(f) for n, f in ours.get("cameras", {}).items() if n in source.features}
        depths = {name: Feature.from_json(f) for name, f in ours.get("depths", {}).items()}
        matrices = {
            camera: {name: Feature.from_json(f) for name, f in known.items()}
            for camera, known in ours.get("calibration", {}).items()
        }
    except (KeyError, TypeError, AttributeError) as err:
        raise CorruptEpisode(f"{source.root / RCS_FILE} is damaged: {err!r}.") from err
    _check_own(source, columns, cameras, depths)
    return columns, cameras, depths, matrices


def _check_own(
    source: LeRobotSource, columns: list[Column], cameras: dict[str, Feature], depths: dict[str, Feature]
) -> None:
    """Refuse our description if it disagrees with LeRobot's, or if its names lead out of the folder."""
    wrong = [column.name for column in columns if not column.parts.features or column.dtype not in (*DTYPES, "float16")]
    wrong += [f.key for column in columns for f in column.parts.features if f.is_image]
    wrong += [name for name, feature in cameras.items() if feature.encoding not in ("jpeg", "lossless")]
    wrong += [name for name, feature in depths.items() if feature.encoding != "depth"]
    wrong += [name for name in depths if not all(is_name(word) for word in name.split("/"))]
    if wrong:
        raise CorruptEpisode(f"{source.root / RCS_FILE} is damaged: its entries {', '.join(wrong)} are impossible.")


def _feature(name: str, shape: tuple[int, ...], dtype: str) -> Feature:
    if name == REWARD and shape == (1,):
        return Feature(key="reward", shape=(), dtype=dtype)
    for prefix in ("observation", "action"):
        if name.startswith(prefix):
            rest = name.removeprefix(prefix).strip(".").replace(".", "/").replace("//", "/")
            return Feature(key=f"{prefix}/{rest or prefix}", shape=shape, dtype=dtype)
    return Feature(key=f"extra/{name.replace('/', '.')}", shape=() if shape == (1,) else shape, dtype=dtype)


def _single(name: str, feature: Feature) -> Column:
    return Column(name=name, dtype=feature.dtype, parts=VectorLayout(features=(feature,)))


def _sizes(shape: tuple[int, ...], names: Any) -> tuple[int, int, int]:
    # Old datasets have (channels, height, width), and some say "channel".
    first = str(names[0]) if isinstance(names, list) and names else ""
    if first.startswith("channel") or (not first and shape[0] in (1, 3) and shape[-1] not in (1, 3)):
        return shape[1], shape[2], shape[0]
    return shape[0], shape[1], shape[2]
