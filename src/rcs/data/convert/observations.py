"""What an export takes of the observations, and the names that it has there: what formats with a key per part share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.data.convert.options import ExportOptions, selected_cameras
from rcs.data.feature import Feature
from rcs.data.info import DatasetInfo
from rcs.data.reader import EpisodeRecord
from rcs.data.trajectory import FRAMES, OBSERVATION, VectorLayout
from rcs.errors import InvalidSetup


@dataclass(frozen=True)
class FrameKey:
    """The camera and the kind that are in a key such as "observation/frames/wrist/rgb"."""

    camera: str
    """Its name; of two robots it may have a "/"."""
    kind: str
    """Such as "rgb", "depth" or "intrinsics"."""

    @classmethod
    def of(cls, key: str) -> FrameKey | None:
        """Return what is in a key, or None where it is of no camera."""
        words = key.split("/")
        if words[:2] != [OBSERVATION, FRAMES] or len(words) < 4:
            return None
        return cls("/".join(words[2:-1]), words[-1])


def kept_info(info: DatasetInfo, options: ExportOptions) -> DatasetInfo:
    """Return the info without all that belongs to a camera that is not exported.

    Args:
        info: What the dataset's episodes share.
        options: Which cameras.

    Raises:
        InvalidSetup: A camera is unknown.
    """
    frame_keys = {feature.key: FrameKey.of(feature.key) for feature in info.features}
    known = list(dict.fromkeys(key.camera for key in frame_keys.values() if key is not None))
    dropped = set(known) - set(selected_cameras(known, options))
    suffixes = tuple(f"/frames/{camera}" for camera in dropped)  # of its times and flags
    features = tuple(
        feature
        for feature in info.features
        if not (frame.camera in dropped if (frame := frame_keys[feature.key]) else feature.key.endswith(suffixes))
    )
    return replace(info, features=features)


def observed(info: DatasetInfo) -> tuple[Feature, ...]:
    """Return the features that were seen, numbers and images."""
    return tuple(feature for feature in info.features if feature.key.startswith(f"{OBSERVATION}/"))


def named(features: Sequence[Feature], name: Callable[[Feature], str], taken: Sequence[str] = ()) -> dict[str, Feature]:
    """Return the features by the name that they have in a format.

    Args:
        features: The features.
        name: The name of one of them.
        taken: Names that the format uses itself.

    Raises:
        InvalidSetup: Two would have one name.
    """
    found: dict[str, Feature] = {}
    for feature in features:
        short = name(feature)
        if short in found or short in taken:
            other = found[short].key if short in found else "the format itself"
            raise InvalidSetup(f"{feature.key!r} would be named {short!r}, and so is {other!r}; leave one of them out.")
        found[short] = feature
    return found


def step_values(episode: EpisodeRecord, feature: Feature) -> NDArray[Any]:
    """Return a column of numbers step by step: what was seen before each, or what it did; shape (steps, *shape).

    Raises:
        CorruptEpisode: The episode is damaged.
    """
    is_after = feature.is_unknown_at_reset or feature.key in ("terminated", "truncated")
    column = episode.column(feature.key)
    return column[1:] if is_after else column[:-1]


def describe_layout(layout: VectorLayout) -> list[dict[str, Any]]:
    """Return as JSON values which numbers of a vector are what, in which unit."""
    return [
        {"key": feature.key, "start": place.start, "end": place.stop, "unit": feature.unit}
        for feature, place in zip(layout.features, layout.slices.values(), strict=True)
    ]


def as_float32(values: NDArray[Any]) -> NDArray[np.float32]:
    """Return numbers as most trainers keep them."""
    return np.ascontiguousarray(values, np.float32)
