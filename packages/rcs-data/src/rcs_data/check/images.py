"""Checks the images of an episode: frozen or repeated although the robot moves, or black."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from rcs_data.check.episode_rows import EpisodePlace, EpisodeRows
from rcs_data.check.report import Finding, counted

# A camera is frozen if its image stays the same for longer than this and three of its periods while the robot moves.
_FREEZE_S = 1.0
_FREEZE_PERIODS = 3
# How far a joint of every arm must move meanwhile [rad], so that even a small, distant image would show it.
_MOVED = 0.1
_MOVED_IN_A_STEP = 0.02
# New images that equal the one before byte for byte. A sensor's noise prevents them. A simulation without noise has
# them where a wrist moves over a bare table, in one or two runs; a camera slower than its flags say repeats all along.
_REPEATS = 10
_REPEATED_SHARE = 0.1
_REPEATED_RUNS = 5


def check_images(place: EpisodePlace, rows: EpisodeRows) -> Iterator[Finding]:
    """Yield findings about the images of an episode."""
    if rows.length < 2:
        return
    for camera, keys in rows.cameras.items():
        for key in keys:
            black = np.flatnonzero(rows.frames[key].is_black)
            if len(black):
                yield place.warning("black", f"{key!r} is black in {counted(len(black), 'row')}", black)
        if not _is_tactile(rows, camera):  # a gel without contact looks the same everywhere
            yield from _frozen(place, rows, camera, keys)


def _frozen(place: EpisodePlace, rows: EpisodeRows, camera: str, keys: list[str]) -> Iterator[Finding]:
    columns = (rows.column(key) for key in rows.joints)
    joints = [column.reshape(rows.length, -1) for column in columns if column is not None]
    if not joints:
        return  # motion is unknown
    for key in keys:
        log = rows.frames[key]
        is_new, is_same = np.array(log.is_new), np.array(log.is_same)
        starts = np.flatnonzero(is_new & ~is_same)
        if not len(starts):
            continue
        ends = np.append(starts[1:], rows.length) - 1
        period = float(np.median(ends - starts + 1))
        # If the camera is frozen from the start, its own period says nothing.
        bound = max(_FREEZE_S * rows.info.frequency, min(_FREEZE_PERIODS * period, rows.length / 2))
        runs = zip(starts.tolist(), ends.tolist(), strict=True)
        long = [(a, b) for a, b in runs if b - a > bound and _moved(joints, a, b) > _MOVED]
        if long:
            first, last = max(long, key=lambda run: run[1] - run[0])
            seconds = (last - first) / rows.info.frequency
            message = f"{camera!r} is frozen for {seconds:.1f} s while the robot moves ({key!r})"
            yield place.finding("warning", "frozen", message, rows=(first, last))
            continue
        moves = np.min([np.abs(np.diff(column, axis=0)).max(axis=1) for column in joints], axis=0)
        repeated = np.flatnonzero(is_same[1:] & (moves > _MOVED_IN_A_STEP)) + 1
        runs_of_it = np.count_nonzero(np.diff(repeated, prepend=-1) > 1)
        is_often = len(repeated) >= _REPEATS and len(repeated) > _REPEATED_SHARE * is_new.sum()
        if is_often and runs_of_it >= _REPEATED_RUNS:
            times = counted(len(repeated), "row")
            message = f"{key!r} is marked as new but equals the image before in {times} while the robot moves"
            yield place.warning("repeated_images", message, repeated)


def _moved(joints: list[NDArray[np.float64]], first: int, last: int) -> float:
    """Return how far the arm that moves least moved from one row to another [rad]."""
    return min(float(np.ptp(column[first : last + 1], axis=0).max()) for column in joints)


def _is_tactile(rows: EpisodeRows, camera: str) -> bool:
    setup = rows.info.setup
    cameras = setup.get("cameras")
    names = cameras.get("names") if isinstance(cameras, dict) else None
    return bool(setup.get("tactile")) and not (isinstance(names, list) and camera in names)
