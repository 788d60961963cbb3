"""Flags of camera frames, and the keys of a camera's flags and capture times."""

from __future__ import annotations

import enum
from collections.abc import Iterable

from rcs_data.files.feature import Feature


class FrameFlag(enum.IntFlag):
    """The state of a camera's frame in one row; 0 is a new frame in time."""

    REPEATED = 1
    """The camera had no new frame since the row before; normal for one that is slower than the loop."""
    STALE = 2
    """The frame is older than it should be at this camera's rate: the camera stalls."""
    MISSING = 4
    """The camera gave no usable frame."""
    DROPPED = 8
    """The recorder had no room for a new frame: the disk or the processor is too slow. The row, and those that repeat
    the frame, show an older one."""


def camera_of(key: str) -> str | None:
    """Return the camera of a feature: "wrist" for "observation/frames/wrist/rgb"; None for others.

    With several robots, its name may contain a "/".
    """
    words = key.split("/")
    return "/".join(words[2:-1]) if words[:2] == ["observation", "frames"] and len(words) > 3 else None


def time_key(camera: str) -> str:
    """Return the key of a camera's capture times."""
    return f"time/frames/{camera}"


def flags_key(camera: str) -> str:
    """Return the key of a camera's flags."""
    return f"flags/frames/{camera}"


def companion(key: str, features: Iterable[Feature], naming: str) -> str | None:
    """Return the key of the capture times ("time") or flags ("flags") beside an image; None if there are none."""
    camera = camera_of(key)
    if camera is None:
        return None
    name = f"{naming}/frames/{camera}"
    return name if any(feature.key == name for feature in features) else None
