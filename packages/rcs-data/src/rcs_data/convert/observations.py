"""Selects and names observations for export formats with a key per part."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rcs_data.convert.options import (
    ExportOptions,
    ExportReport,
    ImportOptions,
    no_step_notes,
    selected_cameras,
    stored_as,
)
from rcs_data.errors import InvalidSetup
from rcs_data.files.feature import DTYPES, DType, Feature
from rcs_data.files.flags import camera_of
from rcs_data.files.info import DatasetInfo
from rcs_data.files.output import size_on_disk
from rcs_data.read.reader import Dataset, EpisodeRecord
from rcs_data.read.trajectory import FRAMES, OBSERVATION, VectorLayout

ACTION_DICT = "action_dict/"
"""Begins the keys of other forms of the action, which are no part of it; zeros in the first row."""


def kept_info(info: DatasetInfo, options: ExportOptions | ImportOptions) -> DatasetInfo:
    """Return the info without the features of cameras that are not chosen; InvalidSetup if one is unknown."""
    cameras = {feature.key: camera_of(feature.key) for feature in info.features}
    known = list(dict.fromkeys(filter(None, cameras.values())))
    dropped = set(known) - set(selected_cameras(known, options))
    suffixes = tuple(f"/frames/{camera}" for camera in dropped)  # its times and flags
    features = tuple(
        feature
        for feature in info.features
        if not (camera in dropped if (camera := cameras[feature.key]) else feature.key.endswith(suffixes))
    )
    return replace(info, features=features)


def observed(info: DatasetInfo) -> tuple[Feature, ...]:
    """Return the observed features, numbers and images."""
    return tuple(feature for feature in info.features if feature.key.startswith(f"{OBSERVATION}/"))


def named(features: Sequence[Feature], name: Callable[[Feature], str], taken: Sequence[str] = ()) -> dict[str, Feature]:
    """Return the features by their name in a format.

    Raises:
        InvalidSetup: Two would share a name, or one has a name that is `taken` by the format itself.
    """
    found: dict[str, Feature] = {}
    for feature in features:
        short = name(feature)
        if short in found or short in taken:
            other = found[short].key if short in found else "the format itself"
            raise InvalidSetup(f"{feature.key!r} and {other!r} would both be named {short!r}; leave one of them out.")
        found[short] = feature
    return found


def short_name(feature: Feature, of_frames: str) -> str:
    """Return the name of a feature in a format where that is one word, such as "left_joints".

    Args:
        feature: The feature.
        of_frames: How what belongs to a camera is named: "{camera}_{kind}" gives "wrist_image" and "wrist_depth".
    """
    camera, word = camera_of(feature.key), feature.key.rpartition("/")[2]
    if camera is None:
        return feature.key.removeprefix(f"{OBSERVATION}/").replace("/", "_")
    return of_frames.format(camera=camera.replace("/", "_"), kind="image" if word == "rgb" else word)


def is_done(feature: Feature) -> bool:
    """Return whether a feature describes what a step did, not the observation before it."""
    is_end = feature.key in ("terminated", "truncated")
    return is_end or feature.is_unknown_at_reset or feature.key.startswith(ACTION_DICT)


def kept_dtype(name: str) -> DType | None:
    """Return the dtype of a dataset that numbers of others become, float32 for halves; None if there is none."""
    return next(
        (known for known in DTYPES if known == {"float16": "float32", "bfloat16": "float32"}.get(name, name)), None
    )


def camera_feature(camera: str, shape: tuple[int, ...], dtype: str, options: ImportOptions) -> Feature | None:
    """Return the feature of imported images, colour of 8 bits or depth of 16; None if they are neither."""
    key = f"{OBSERVATION}/{FRAMES}/{camera}"
    if dtype == "uint8" and len(shape) == 3 and shape[2] == 3:
        return stored_as(Feature(key=f"{key}/rgb", shape=shape, dtype=dtype, encoding="jpeg"), options)
    if dtype == "uint16" and (len(shape) == 2 or (len(shape) == 3 and shape[2] == 1)):
        return Feature(key=f"{key}/depth", shape=shape[:2], dtype=dtype, encoding="depth")
    return None


def export_report(
    path: Path,
    dataset: Dataset,
    options: ExportOptions,
    episodes: Sequence[EpisodeRecord],
    frames: int,
    notes: Iterable[str] = (),
) -> ExportReport:
    """Return the result of an export: the file or folder, its episodes, number of images and what was left out."""
    return ExportReport(
        path=path,
        episodes=len(episodes),
        steps=sum(episode.length - 1 for episode in episodes),
        frames=frames,
        bytes_written=size_on_disk(path),
        notes=(*no_step_notes(dataset, options), *notes),
    )


def describe_layout(layout: VectorLayout) -> list[dict[str, Any]]:
    """Return names and units of a vector's numbers, as JSON values."""
    return [
        {"key": feature.key, "start": place.start, "end": place.stop, "unit": feature.unit}
        for feature, place in zip(layout.features, layout.slices.values(), strict=True)
    ]
