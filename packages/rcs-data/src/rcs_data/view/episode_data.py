"""Data of an episode on the page beside its clips: curves, and marks where the recording has a flaw."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from rcs_data.files.feature import Feature
from rcs_data.files.flags import FrameFlag, camera_of, flags_key, time_key
from rcs_data.files.info import DatasetInfo
from rcs_data.read.content import flat_numbers
from rcs_data.read.reader import EpisodeRecord

FLAWS = ("repeated", "stale", "missing", "dropped", "gap", "jitter", "backwards")
"""Kinds of marks: the first four are about a camera's frames, the others about the loop's periods."""

LOOP = "loop"
"""Place of the marks of periods; the others are at a camera."""

# As the quality report of an episode has it: at least one step is missing.
_GAP = 1.5
# A period this far off the wanted one is seen in the data of a moving arm: at 1 rad/s and 30 Hz by 7 mrad.
_JITTER = 0.2
# Curves of more numbers are pictures.
_MOST_LINES = 32
_SHOWN = ("joints", "gripper", "hand", "reward")
# Commands stand beside measurements.
_SOURCES = ("observation", "action", "executed")
_PERIOD = "period"
MOST_STEPS = 1 << 18
"""Longer episodes are not shown: at 30 Hz these are two hours and a half."""
# More numbers than these are thinned out; each takes 32 bytes in Python and ten in the page.
_MOST_NUMBERS = 1_000_000
_POSE_NAMES = {
    "tquat": "x y z qx qy qz qw",
    "xyzrpy": "x y z roll pitch yaw",
    "twist": "vx vy vz wx wy wz",
    "quaternion": "x y z w",
}


@dataclass(frozen=True, kw_only=True)
class Curves:
    """One plot: the numbers of one feature over the rows."""

    key: str
    """The feature, or "period"."""
    unit: str
    """In words."""
    size: int
    is_shown: bool
    """Whether the page shows it at first."""

    @property
    def names(self) -> list[str]:
        """Names of the lines: "joint 1" and so on, the axes of a pose, or numbers from 1."""
        last = self.key.split("/")[-1]
        names = _POSE_NAMES.get(last, "").split()
        if len(names) == self.size:
            return names
        word = "joint " if last in ("joints", "joint_velocities", "hand") else ""
        return [""] if self.size == 1 else [f"{word}{i + 1}" for i in range(self.size)]

    def to_json(self) -> dict[str, Any]:
        """Return what the page needs to know."""
        label = self.key.replace("/", " \N{MIDDLE DOT} ")
        return {"label": label, "names": self.names, "unit": self.unit, "shown": self.is_shown}


def curves(info: DatasetInfo) -> list[Curves]:
    """Return the plots of a dataset's episodes: state, action, what was executed, reward, periods."""
    found: list[Curves] = []
    for feature in info.features:
        is_number = not feature.is_image and feature.numpy_dtype.kind in "fiub"
        is_drawn = is_number and not feature.is_circumstance and feature.size <= _MOST_LINES
        if not is_drawn or camera_of(feature.key) is not None or feature.is_time:
            continue
        words = feature.key.split("/")
        # A pose that is there in two notations is for those who ask; what was commanded is always of interest.
        is_shown = words[-1] in _SHOWN or words[0] in ("action", "executed")
        found.append(Curves(key=feature.key, unit=feature.unit, size=feature.size, is_shown=is_shown))
    if any(feature.key in ("time/monotonic", "time/period") for feature in info.features):
        found.append(Curves(key=_PERIOD, unit="ms", size=1, is_shown=True))
    return sorted(found, key=_place)


def _place(curve: Curves) -> tuple[bool, bool, list[str], int, str, int]:
    """Order plots: those of each robot, joints before the gripper, and beside each other what is of the same name."""
    first, *robot, last = curve.key.split("/") if "/" in curve.key else ("", curve.key)
    rank = _SHOWN.index(last) if last in _SHOWN else len(_SHOWN)
    return not curve.is_shown, not first, robot, rank, last if first else "", _source(first)


def _source(word: str) -> int:
    return _SOURCES.index(word) if word in _SOURCES else len(_SOURCES)


def episode_data(episode: EpisodeRecord) -> dict[str, Any]:
    """Return the curves and marks of an episode as JSON values.

    Returns:
        `rows`; `stride`: a curve has a number for every so many rows; `curves`: for each of `curves`, for each line,
        its numbers or None; `marks`: where, what, and the first and last row of each run; `flaws`: how many rows each
        kind of flaw has.

    Raises:
        CorruptEpisode: The episode is damaged.
    """
    lines: list[list[list[float | None]]] = []
    drawn = curves(episode.info)
    columns = _columns(episode, {curve.key for curve in drawn})
    periods = _periods(columns, episode.length)
    stride = -(-episode.length * sum(curve.size for curve in drawn) // _MOST_NUMBERS) or 1
    for curve in drawn:
        values = 1e3 * periods[:, None] if curve.key == _PERIOD else columns[curve.key]
        lines.append([rounded(line) for line in values[::stride].T])
    marks = list(_marks(episode, columns, periods))
    flaws = {flaw: sum(len(rows) for _, kind, rows in marks if kind == flaw) for flaw in FLAWS}
    return {
        "rows": episode.length,
        "stride": stride,
        "curves": lines,
        "marks": [{"at": at, "flaw": flaw, "runs": _runs(rows)} for at, flaw, rows in marks],
        "flaws": {flaw: count for flaw, count in flaws.items() if count},
    }


def is_faster_than_life(info: DatasetInfo) -> bool:
    """Return whether the episodes were simulated without waiting for the wall clock, so that periods mean nothing."""
    return info.sim_state_size is not None and info.setup.get("stepping") == "async"


def _columns(episode: EpisodeRecord, keys: set[str]) -> dict[str, NDArray[np.float64]]:
    """Return the columns of some curves, of flags and of times, shape (length, size) each, NaN where there is nothing.

    They are read together: a file is opened as long as twenty rows take to read.
    """
    features = [f for f in episode.info.features if f.key in keys or f.key.startswith(("time/", "flags/"))]
    if not features:
        return {}
    table = episode.steps(feature.key for feature in features)
    return {feature.key: _numbers(table.column(feature.key), feature) for feature in features}


def _numbers(column: pa.ChunkedArray, feature: Feature) -> NDArray[np.float64]:
    numbers = flat_numbers(column).reshape(-1, feature.size).astype(np.float64)
    numbers[column.is_null().to_numpy()] = np.nan
    return numbers


def _marks(
    episode: EpisodeRecord, columns: Mapping[str, NDArray[np.float64]], periods: NDArray[np.float64]
) -> Iterator[tuple[str, str, NDArray[np.intp]]]:
    images = [feature.key for feature in episode.info.features if feature.is_image]
    cameras = dict.fromkeys(camera for key in images if (camera := camera_of(key)) is not None)
    for camera in cameras:
        flags = np.zeros(episode.length, np.uint8)
        if flags_key(camera) in columns:
            flags = np.nan_to_num(columns[flags_key(camera)][:, 0]).astype(np.uint8)
        repeated = (flags & FrameFlag.REPEATED) > 0
        if time_key(camera) in columns:  # captured at the same time; a NaN equals nothing
            repeated[1:] |= np.diff(columns[time_key(camera)][:, 0]) == 0
        repeated |= np.all([_seen_twice(episode, key) for key in images if camera_of(key) == camera], axis=0)
        others = {flag: (flags & flag) > 0 for flag in (FrameFlag.STALE, FrameFlag.MISSING, FrameFlag.DROPPED)}
        named = {"repeated": repeated, **{str(flag.name).lower(): rows for flag, rows in others.items()}}
        yield from ((camera, flaw, np.flatnonzero(rows)) for flaw, rows in named.items() if rows.any())
    if is_faster_than_life(episode.info):
        return
    wanted = 1 / episode.info.frequency
    with np.errstate(invalid="ignore"):  # a period that was not measured is no flaw
        gap, backwards = periods > _GAP * wanted, periods <= 0
        jitter = (np.abs(periods - wanted) > _JITTER * wanted) & ~gap & ~backwards
    named = {"gap": gap, "jitter": jitter, "backwards": backwards}
    yield from ((LOOP, flaw, np.flatnonzero(rows)) for flaw, rows in named.items() if rows.any())


def _seen_twice(episode: EpisodeRecord, key: str) -> NDArray[np.bool_]:
    """Return in which rows the image is byte for byte that of the row before."""
    rows = np.zeros(episode.length, np.bool_)
    last: bytes | None = None
    for row, data in enumerate(episode.encoded_frames(key)):
        rows[row] = data == last
        last = data
    return rows


def _periods(columns: Mapping[str, NDArray[np.float64]], length: int) -> NDArray[np.float64]:
    """Return how long each step took [s], shape (length,); NaN where it was not measured, as at the reset."""
    periods = np.full(length, np.nan)
    if "time/monotonic" in columns:
        periods[1:] = np.diff(columns["time/monotonic"][:, 0])
    elif "time/period" in columns:
        periods[:] = columns["time/period"][:, 0]
    return periods


def _runs(rows: NDArray[np.intp]) -> list[list[int]]:
    """Return the first and the last of each run of neighbours."""
    parts = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    return [[int(part[0]), int(part[-1])] for part in parts if len(part)]


def rounded(line: NDArray[np.float64]) -> list[float | None]:
    """Return numbers with what a plot can show: a ten thousandth of their range; None for what is no number."""
    values = line
    finite = values[np.isfinite(values)]
    spread = float(np.ptp(finite)) if finite.size else 0.0
    largest = max(spread, 1e-3 * float(np.abs(finite).max(initial=0.0)), 1e-12)
    places = 4 - math.floor(math.log10(largest))
    rounded = np.round(values, places) if places < 300 else values
    whole = places <= 0
    return [(int(value) if whole else value) if math.isfinite(value) else None for value in rounded.tolist()]
