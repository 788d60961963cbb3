"""Maps the columns of a LeRobotDataset to features.

Our exports list their features in `meta/rcs.json`, which restores their names. In other datasets

- `observation.state` becomes `observation/state`, and so on for all columns that begin with "observation."; so do the
names of openpi's examples, `state`, `joint_position` and the like;
- `action` and `actions` become `action/action`, `action.gripper` becomes `action/gripper`;
- `next.reward` becomes `reward`, `next.terminated` `terminated`, `next.truncated` `truncated`;
- a video or image becomes `observation/frames/<camera>/rgb`, where <camera> is its name without "observation.images.";
- a column of texts becomes numbers with labels, `extra/<name>`; so does a column that numbers tasks (GR00T's
annotations) or subtasks, and `task_index` where it changes within an episode;
- all other columns of numbers become `extra/<name>`: masks such as `action_mask`, too, and `next.done`, since it does
not distinguish the end of a task from that of a recording.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from rcs_data.convert.lerobot.layout import (
    DONE,
    INDICES,
    RCS_FILE,
    REWARD,
    SUCCESS,
    TERMINATED,
    TEXT,
    TRUNCATED,
    Column,
    single_column,
)
from rcs_data.convert.lerobot.source import LeRobotSource
from rcs_data.convert.observations import kept_dtype
from rcs_data.convert.options import ImportOptions, selected_cameras, stored_as
from rcs_data.errors import CorruptEpisode
from rcs_data.files.feature import DType, Feature
from rcs_data.files.flags import camera_of
from rcs_data.read.trajectory import VectorLayout

_SINGLES = {REWARD: "reward", "reward": "reward", TERMINATED: "terminated", TRUNCATED: "truncated"}
# Names in openpi's examples and converters in use (LIBERO, DROID, ALOHA).
_STATES = re.compile(r"state|proprio|qpos|(joint|gripper|cartesian)_(position|velocity)")
_MASK = re.compile(r"(.*[._])?(mask|is_pad)")
# The camera of "observation.images.wrist" is "wrist"; that of "observation.image" is "image".
_PREFIXES = ("observation.images.", "observations.images.", "observation.image.", "observation.")


@dataclass(frozen=True, kw_only=True)
class FeatureMapping:
    """The features of a LeRobot dataset's columns."""

    columns: tuple[Column, ...]
    """Columns of numbers."""
    labels: dict[str, Feature]
    """Columns of texts, or of numbers that stand for texts."""
    cameras: dict[str, Feature]
    """Columns of images."""
    features: tuple[Feature, ...]
    """All features, in the order of the new dataset."""
    left_out: dict[str, str]
    """Columns that are left out, with the reason."""


def feature_mapping(source: LeRobotSource, options: ImportOptions, carrying: Iterable[str] = ()) -> FeatureMapping:
    """Choose the features.

    Args:
        source: The LeRobot dataset.
        options: Cameras to import, and how their images are stored.
        carrying: `timestamp` if it is more than frame number over rate, `task_index` if it changes within an episode.

    Raises:
        InvalidSetup: A camera is unknown.
        CorruptEpisode: `meta/rcs.json` is damaged.
    """
    columns, cameras = _own(source)
    known = {*(column.name for column in columns), *cameras, *({DONE, SUCCESS} if source.ours else ())}
    labels: dict[str, Feature] = {}
    left_out: dict[str, str] = {}
    for name, about in source.features.items():
        if name in known or (name in INDICES and name not in carrying):
            continue
        dtype, shape = str(about["dtype"]), tuple(int(n) for n in about["shape"])
        if dtype in ("video", "image"):
            reason = _not_rgb(about, shape)
            if reason:
                left_out[name] = reason
            else:
                height, width, _ = _sizes(shape, about.get("names"))
                prefix = next((prefix for prefix in _PREFIXES if name.startswith(prefix)), "")
                key = f"observation/frames/{name.removeprefix(prefix)}/rgb"
                cameras[name] = Feature(key=key, shape=(height, width, 3), dtype="uint8", encoding="jpeg")
        elif name == "timestamp":
            columns.append(single_column(Feature(key="time/timestamp", shape=(), dtype="float64", unit="s"), name))
        elif shape in ((), (1,)) and (dtype == TEXT or _counts_texts(source, name, dtype)):
            labels[name] = Feature(key=_extra(name), shape=(), dtype="int32")
        elif (kept := kept_dtype(dtype)) is None:
            left_out[name] = f"{dtype} of shape {shape} is neither numeric nor a text"
        else:
            columns.append(single_column(_feature(name, shape, kept), name))
    by_camera = {camera_of(f.key) or "": name for name, f in cameras.items()}
    chosen = selected_cameras(by_camera, options)
    cameras = {name: stored_as(cameras[name], options) for camera, name in by_camera.items() if camera in chosen}
    parts = [f for column in columns for f in column.parts.features]
    parts += [*labels.values(), *cameras.values()]
    order = source.ours.get("order", [])
    if not isinstance(order, list):
        raise CorruptEpisode(f"{source.root / RCS_FILE} is damaged: its order is {order!r:.80}.")
    place = {key: number for number, key in enumerate(order) if isinstance(key, str)}
    return FeatureMapping(
        columns=tuple(columns),
        labels=labels,
        cameras=cameras,
        features=tuple(sorted(parts, key=lambda f: place.get(f.key, len(place)))),
        left_out=left_out,
    )


def _own(source: LeRobotSource) -> tuple[list[Column], dict[str, Feature]]:
    """Return the columns and cameras that our export describes; none if it is another's."""
    ours = source.ours
    try:
        columns = [
            Column(
                name=column["name"],
                dtype=source.features[column["name"]]["dtype"],
                parts=VectorLayout(features=tuple(Feature.from_json(f) for f in column["features"])),
            )
            for column in ours.get("columns", ())
            if source.features.get(column["name"], {}).get("dtype", TEXT) != TEXT
        ]
        cameras = {n: Feature.from_json(f) for n, f in ours.get("cameras", {}).items() if n in source.features}
    except (KeyError, TypeError, AttributeError) as err:
        raise CorruptEpisode(f"{source.root / RCS_FILE} is damaged: {err!r}.") from err
    # Our description must agree with LeRobot's.
    wrong = [column.name for column in columns if not column.parts.features or kept_dtype(column.dtype) is None]
    wrong += [f.key for column in columns for f in column.parts.features if f.is_image]
    wrong += [name for name, feature in cameras.items() if feature.colour is None]
    if wrong:
        raise CorruptEpisode(f"{source.root / RCS_FILE} is damaged: its entries {', '.join(wrong)} are impossible.")
    return columns, cameras


def _feature(name: str, shape: tuple[int, ...], dtype: DType) -> Feature:
    if name in _SINGLES and shape == (1,) and (name == REWARD or name == "reward" or dtype == "bool"):
        return Feature(key=_SINGLES[name], shape=(), dtype=dtype)
    first, *rest = [word for word in re.split("[./]", name) if word] or [name]
    if _MASK.fullmatch(name):
        pass
    elif first in ("action", "actions"):
        return Feature(key="/".join(["action", *(rest or ["action"])]), shape=shape, dtype=dtype)
    elif first in ("observation", "observations"):
        return Feature(key="/".join(["observation", *(rest or ["observation"])]), shape=shape, dtype=dtype)
    elif _STATES.fullmatch(name):
        return Feature(key=f"observation/{name}", shape=shape, dtype=dtype)
    return Feature(key=_extra(name), shape=() if shape == (1,) else shape, dtype=dtype)


def _counts_texts(source: LeRobotSource, name: str, dtype: str) -> bool:
    is_known = bool(source.subtasks) if name == "subtask_index" else name == "task_index"
    return dtype.startswith("int") and (is_known or (name.startswith("annotation.") and bool(source.tasks)))


def _extra(name: str) -> str:
    return f"extra/{name.replace('/', '.')}"


def _not_rgb(about: Mapping[str, Any], shape: tuple[int, ...]) -> str:
    info = about.get("info") or about.get("video_info")
    info = info if isinstance(info, dict) else {}
    if len(shape) != 3:
        return f"its images have the shape {shape}"
    is_depth = info.get("video.is_depth_map") or info.get("is_depth_map")
    return "its images are not RGB" if is_depth or _sizes(shape, about.get("names"))[2] != 3 else ""


def _sizes(shape: tuple[int, ...], names: Any) -> tuple[int, int, int]:
    # Old datasets have (channels, height, width), and some say "channel".
    first = str(names[0]) if isinstance(names, list) and names else ""
    if first.startswith("channel") or (not first and shape[0] in (1, 3) and shape[-1] not in (1, 3)):
        return shape[1], shape[2], shape[0]
    return shape[0], shape[1], shape[2]
