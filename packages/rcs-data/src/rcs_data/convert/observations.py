"""Selects and names observations for export formats with a key per part."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.convert.options import ExportOptions, ImportOptions, selected_cameras
from rcs_data.errors import InvalidSetup
from rcs_data.feature import Feature
from rcs_data.info import DatasetInfo
from rcs_data.reader import Dataset, EpisodeRecord
from rcs_data.trajectory import FRAMES, OBSERVATION, VectorLayout


@dataclass(frozen=True)
class FrameKey:
    """The camera and kind of a key such as "observation/frames/wrist/rgb"."""

    camera: str
    """Its name; with several robots it may contain a "/"."""
    kind: str
    """Such as "rgb", "depth" or "intrinsics"."""

    @classmethod
    def of(cls, key: str) -> FrameKey | None:
        """Return the camera and kind of a key; None if it belongs to no camera."""
        words = key.split("/")
        if words[:2] != [OBSERVATION, FRAMES] or len(words) < 4:
            return None
        return cls("/".join(words[2:-1]), words[-1])


def export_name(dataset: Dataset) -> str:
    """Return the name of a dataset's folder, as far as letters, digits and "_" go."""
    name = re.sub(r"\W+", "_", dataset.path.resolve().name, flags=re.ASCII).strip("_").lower()
    return name if name[:1].isalpha() else f"rcs_{name}".rstrip("_")


def kept_info(info: DatasetInfo, options: ExportOptions | ImportOptions) -> DatasetInfo:
    """Return the info without the features of cameras that are not chosen.

    Raises:
        InvalidSetup: A camera is unknown.
    """
    frame_keys = {feature.key: FrameKey.of(feature.key) for feature in info.features}
    known = list(dict.fromkeys(key.camera for key in frame_keys.values() if key is not None))
    dropped = set(known) - set(selected_cameras(known, options))
    suffixes = tuple(f"/frames/{camera}" for camera in dropped)  # its times and flags
    features = tuple(
        feature
        for feature in info.features
        if not (frame.camera in dropped if (frame := frame_keys[feature.key]) else feature.key.endswith(suffixes))
    )
    return replace(info, features=features)


def observed(info: DatasetInfo) -> tuple[Feature, ...]:
    """Return the observed features, numbers and images."""
    return tuple(feature for feature in info.features if feature.key.startswith(f"{OBSERVATION}/"))


def named(features: Sequence[Feature], name: Callable[[Feature], str], taken: Sequence[str] = ()) -> dict[str, Feature]:
    """Return the features by their name in a format, which has reserved some.

    Raises:
        InvalidSetup: Two would share a name.
    """
    found: dict[str, Feature] = {}
    for feature in features:
        short = name(feature)
        if short in found or short in taken:
            other = found[short].key if short in found else "the format itself"
            raise InvalidSetup(f"{feature.key!r} and {other!r} would both be named {short!r}; leave one of them out.")
        found[short] = feature
    return found


def step_values(episode: EpisodeRecord, feature: Feature) -> NDArray[Any]:
    """Return a column of numbers by step: the observation before it, or what it did; shape (steps, *shape).

    Raises:
        CorruptEpisode: The episode is damaged.
    """
    is_after = feature.is_unknown_at_reset or feature.key in ("terminated", "truncated")
    column = episode.column(feature.key)
    return column[1:] if is_after else column[:-1]


def describe_layout(layout: VectorLayout) -> list[dict[str, Any]]:
    """Return names and units of a vector's numbers, as JSON values."""
    return [
        {"key": feature.key, "start": place.start, "end": place.stop, "unit": feature.unit}
        for feature, place in zip(layout.features, layout.slices.values(), strict=True)
    ]


def as_float32(values: NDArray[Any]) -> NDArray[np.float32]:
    """Return numbers as float32, as most trainers keep them."""
    return np.ascontiguousarray(values, np.float32)
