"""Resamples episodes to fewer steps per second, each of which replaces several."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rcs_data.edit.episodes import take_rows
from rcs_data.edit.transaction import editing
from rcs_data.errors import InvalidSetup
from rcs_data.files.feature import Feature
from rcs_data.files.flags import FrameFlag, camera_of
from rcs_data.files.info import DatasetInfo
from rcs_data.files.output import OnProgress
from rcs_data.options import require_number
from rcs_data.read.content import flat_numbers

Quaternion = NDArray[np.float64]
"""A rotation as a unit quaternion xyzw, shape (4,)."""
IDENTITY: Quaternion = np.array([0.0, 0.0, 0.0, 1.0])


def resample(path: str | Path, frequency: float, *, on_progress: OnProgress | None = None) -> None:
    """Lower the control rate, for example from 30 to 5 Hz for policies that predict coarse steps.

    A new step ends at the nearest old row; the last row always stays. Its action combines those of the steps it
    replaces: the last one if targets are absolute; if they are relative to the step before, their sum, with rotations
    composed; of velocities the mean. Rewards are summed, and flags are combined by or.

    Args:
        path: The dataset.
        frequency: The new rate [Hz], at most that of the dataset.
        on_progress: Called with the number of episodes done and of all.

    Raises:
        InvalidSetup: The rate is not a number, or not lower than the dataset's, or there are relative actions of which
            nobody knows how to combine them; nothing changes.
        CorruptEpisode: An episode is damaged; nothing changes.
        DatasetError: Somebody writes to the dataset, or the disk fails; nothing changes.
    """
    frequency = require_number("frequency", frequency)
    with editing(path, "resample", {"frequency": frequency}, new_info=lambda info: at_rate(info, frequency)) as edit:
        edit.write_all(lambda one: one.inlined(resampled(one.steps(), one.info, frequency)), on_progress)


def at_rate(info: DatasetInfo, frequency: float) -> DatasetInfo:
    """Return the info at a lower rate.

    Raises:
        InvalidSetup: The rate is not lower than the dataset's, or its relative actions cannot be combined.
    """
    if not 0 < frequency < info.frequency:
        raise InvalidSetup(
            f"frequency is {frequency:g}; valid is above 0 and below the dataset's {info.frequency:g} Hz."
        )
    actions = [feature.key for feature in info.features if feature.key.startswith("action/")]
    unknown = [key for key in actions if key.split("/")[-1] not in (*_TOGETHER, *_ABSOLUTE)]
    if unknown and _is_relative(info):
        raise InvalidSetup(
            f"{', '.join(unknown)} cannot be resampled: of actions relative to the step before, only "
            f"{', '.join(_TOGETHER)} can be combined. Resample before the conversion, or leave them out of a mix."
        )
    return replace(info, frequency=frequency)


def resampled(rows: pa.Table, info: DatasetInfo, frequency: float) -> pa.Table:
    """Return the rows of an episode at a lower rate.

    Args:
        rows: All its rows, with the numbers of images.
        info: Its features and rate.
        frequency: The new rate [Hz].
    """
    kept = kept_rows(rows.num_rows, info.frequency / frequency)
    taken = take_rows(rows, info, kept)
    columns = {field.name: taken.column(field.name).combine_chunks() for field in taken.schema}
    for feature in info.features:
        column = rows.column(feature.key).combine_chunks()
        if feature.key.startswith("action/") and _is_relative(info) and feature.key.split("/")[-1] in _TOGETHER:
            columns[feature.key] = _together(column, feature, kept, info.frequency)
        elif feature.key in ("reward", "time/period"):
            columns[feature.key] = _summed(column, kept)
        elif feature.key in ("terminated", "truncated"):
            columns[feature.key] = _any(column, kept)
        elif feature.is_flags:
            columns[feature.key] = _flags(column, feature, rows, info, kept)
    return pa.Table.from_arrays([columns[name] for name in taken.schema.names], schema=taken.schema)


def kept_rows(length: int, ratio: float) -> NDArray[np.int64]:
    """Return the rows of an episode to keep: those nearest to the new rate's grid, with the first and the last.

    Args:
        length: Rows of the episode.
        ratio: Old rate over new rate, above 1.
    """
    if length < 2:
        return np.arange(length)
    grid = np.rint(np.arange(0, length + ratio) * ratio).astype(np.int64)
    grid = grid[grid < length]
    # The rest after the last row of the grid joins it or is a step of its own, whichever is nearer.
    rest = length - 1 - grid[-1]
    if len(grid) > 1 and rest < ratio / 2:
        grid[-1] = length - 1
    elif rest:
        grid = np.append(grid, length - 1)
    return grid


def _groups(kept: NDArray[np.int64]) -> list[slice]:
    """Return for each kept row but the first the rows that it replaces."""
    return [slice(int(a) + 1, int(b) + 1) for a, b in itertools.pairwise(kept)]


def _summed(column: pa.Array, kept: NDArray[np.int64]) -> pa.Array:
    values = flat_numbers(column)
    sums = [values[group].sum() for group in _groups(kept)]
    return pa.concat_arrays([pa.nulls(1, column.type), pa.array(sums, type=column.type)])


def _any(column: pa.Array, kept: NDArray[np.int64]) -> pa.Array:
    values = flat_numbers(column)
    flags = pa.array([bool(values[group].any()) for group in _groups(kept)], type=column.type)
    return pa.concat_arrays([column.take(pa.array(kept[:1])), flags])


def _flags(column: pa.Array, feature: Feature, rows: pa.Table, info: DatasetInfo, kept: NDArray[np.int64]) -> pa.Array:
    flags = flat_numbers(column)[kept].astype(np.uint8) & ~np.uint8(FrameFlag.REPEATED)
    camera = feature.key.removeprefix("flags/frames/")
    images = [f for f in info.features if f.is_image and camera_of(f.key) == camera]
    if images:
        shown = rows.column(images[0].key).to_numpy()[kept]
        flags[1:][np.diff(shown) == 0] |= np.uint8(FrameFlag.REPEATED)
    return pa.array(flags)


def _is_relative(info: DatasetInfo) -> bool:
    return info.setup.get("relative") == "last_step"


def _sum(steps: NDArray[np.float64], _: float) -> NDArray[np.float64]:
    return steps.sum(axis=0)


def _tquat(steps: NDArray[np.float64], _: float) -> NDArray[np.float64]:
    return np.concatenate([steps[:, :3].sum(axis=0), _turned(normalized(step[3:]) for step in steps)])


def _xyzrpy(steps: NDArray[np.float64], _: float) -> NDArray[np.float64]:
    return np.concatenate([steps[:, :3].sum(axis=0), to_rpy(_turned(from_rpy(step[3:]) for step in steps))])


def _twist(steps: NDArray[np.float64], frequency: float) -> NDArray[np.float64]:
    # Turns about different axes do not add up, so they are composed as those of poses are.
    turn = _turned(from_rotvec(step[3:] / frequency) for step in steps)
    return np.concatenate([steps[:, :3].mean(axis=0), to_rotvec(turn) * frequency / len(steps)])


def _turned(turns: Iterable[Quaternion]) -> Quaternion:
    # A relative step turns about the axes of the base, so a later one is multiplied from the left.
    return functools.reduce(lambda before, turn: multiply(turn, before), turns, IDENTITY)


# How to combine several relative actions, given their rate [Hz], by the last word of their key.
_TOGETHER = {"joints": _sum, "tquat": _tquat, "xyzrpy": _xyzrpy, "xyzyaw": _sum, "twist": _twist}
# The last one of these counts, whatever the arm's are relative to.
_ABSOLUTE = ("gripper", "hand")


def _together(column: pa.Array, feature: Feature, kept: NDArray[np.int64], frequency: float) -> pa.Array:
    values = flat_numbers(column).reshape(len(column), -1)
    combined = _TOGETHER[feature.key.split("/")[-1]]
    whole = np.zeros((len(kept), feature.size), feature.numpy_dtype)
    for i, group in enumerate(_groups(kept)):
        whole[i + 1] = combined(values[group].astype(np.float64), frequency)
    mask = pa.array(np.arange(len(kept)) == 0)
    return pa.FixedSizeListArray.from_arrays(pa.array(whole.reshape(-1)), feature.size, mask=mask)


def multiply(second: Quaternion, first: Quaternion) -> Quaternion:
    """Return the quaternion, shape (4,), of one rotation after another."""
    a, b = second[:3], first[:3]
    vector = second[3] * b + first[3] * a + np.cross(a, b)
    return np.append(vector, second[3] * first[3] - a @ b)


def normalized(quaternion: Quaternion) -> Quaternion:
    """Return a quaternion, shape (4,), scaled to norm 1."""
    return quaternion / np.linalg.norm(quaternion)


def from_rotvec(rotvec: NDArray[np.float64]) -> Quaternion:
    """Return the quaternion of a rotation vector, axis times angle [rad], shape (3,)."""
    half = float(np.linalg.norm(rotvec)) / 2
    return np.append(rotvec / 2 * np.sinc(half / math.pi), math.cos(half))


def to_rotvec(quaternion: Quaternion) -> NDArray[np.float64]:
    """Return the rotation vector [rad], shape (3,), of at most half a turn."""
    upper = quaternion if quaternion[3] >= 0 else -quaternion
    sine = float(np.linalg.norm(upper[:3]))
    if sine < 1e-12:
        return 2 * upper[:3]
    return upper[:3] * (2 * math.atan2(sine, float(upper[3])) / sine)


def from_rpy(rpy: NDArray[np.float64]) -> Quaternion:
    """Return the quaternion of roll, pitch, yaw [rad], shape (3,), about the fixed axes x, y, z in this order."""
    about_x, about_y, about_z = (from_rotvec(angle * axis) for angle, axis in zip(rpy, np.eye(3), strict=True))
    return multiply(about_z, multiply(about_y, about_x))


def to_rpy(quaternion: Quaternion) -> NDArray[np.float64]:
    """Return roll, pitch, yaw [rad], shape (3,); yaw is 0 where the pitch is a quarter turn."""
    x, y, z, w = quaternion
    sine = float(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    if abs(sine) > 1 - 1e-12:
        return np.array([2 * math.atan2(x, w), math.copysign(math.pi / 2, sine), 0.0])
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.array([roll, math.asin(sine), yaw])
