"""Checks intact episodes for what is doubtful: their labels, times, images and motion."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.check.episode_rows import EpisodePlace, EpisodeRows
from rcs_data.check.report import Finding, counted, listed
from rcs_data.files.feature import SIMULATED_TIME, JointBounds
from rcs_data.files.flags import FrameFlag, flags_key, time_key
from rcs_data.files.layout import EPISODE_FILE, EPISODES_FOLDER

# Fewer episodes than this may all fail by chance.
_FEW = 3

# A period this many times the nominal one means that at least one step is missing, as in the timing report.
_GAP = 1.5
# Resampling to a rate that does not divide the old one makes steps of up to twice the period.
_GAP_OF_RESAMPLED = 2.1
# The loop misses its rate if one step in a hundred is off by more than this share of the period.
_JITTER = 0.25
_FEW_ROWS = 100

_FLAGS = {
    FrameFlag.STALE: ("stale", "the camera stalls: its frame was older than it should be"),
    FrameFlag.MISSING: ("missing_frames", "the camera gave no usable frame"),
    FrameFlag.DROPPED: (
        "dropped_frames",
        "the recorder had no room for the frame; the disk or the processor is too slow",
    ),
}

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

# Tolerance of joint limits [rad]: simulated limits are springs, and encoders have offsets.
_BEYOND = 0.02
# Factor by which a step may exceed the velocity limit, and an allowance [rad] for noise of encoders and time stamps.
_FASTER = 1.25
_NOISE = 0.02
# A jump of an unknown arm is this many times the steps around it, and faster than any arm [rad/s].
_OUTLIER = 8.0
_FASTEST = 6.5


def check_labels(place: EpisodePlace, about: dict[str, Any]) -> Iterator[Finding]:
    """Yield findings about the labels of one episode, given the contents of its `episode.json`."""
    warning = partial(place.finding, "warning", file=EPISODE_FILE)
    outcome: Any = about.get("outcome")
    failure = outcome.get("failure") if isinstance(outcome, dict) else None
    if about.get("success") is True and failure:
        yield warning("contradiction", f"is marked as a success, but its outcome says that it failed: {failure!r}")
    if not str(about.get("instruction") or "").strip():
        yield warning("no_instruction", "no instruction; set one with `rcs-data relabel`")
    if about.get("length") == 1:
        yield warning("no_action", "has one row, and so no steps")


def check_verdicts(verdicts: dict[str, bool | None]) -> Iterator[Finding]:
    """Yield findings about the verdicts of all episodes together, given `success` of each by id."""

    def warning(kind: str, message: str) -> Finding:
        return Finding(severity="warning", kind=kind, episode=None, file=EPISODES_FOLDER, message=message)

    unknown = [name for name, success in verdicts.items() if success is None]
    if unknown and len(unknown) == len(verdicts):
        yield warning("no_verdict", "no episode has a verdict; a filter by success keeps none")
    elif unknown:
        yield warning("no_verdict", f"{len(unknown)} of {len(verdicts)} episodes have no verdict: {listed(unknown)}")
    if len(verdicts) >= _FEW and all(success is False for success in verdicts.values()):
        yield warning("all_failed", f"all {len(verdicts)} episodes failed")


def check_times(place: EpisodePlace, rows: EpisodeRows, *, is_resampled: bool) -> Iterator[Finding]:
    """Yield findings about the times of an episode, which was resampled to another rate or not."""
    yield from _backwards(place, rows)
    yield from _periods(place, rows, is_resampled)
    yield from _camera_flags(place, rows)
    writer = rows.about.get("timing", {}).get("writer") or {}
    if dropped := writer.get("dropped_rows"):
        message = f"the recorder dropped {counted(dropped, 'whole row')}; the disk or the processor is too slow"
        yield place.warning("dropped_rows", message)


def _backwards(place: EpisodePlace, rows: EpisodeRows) -> Iterator[Finding]:
    for key in ("time/monotonic", SIMULATED_TIME):
        clock = rows.column(key)
        bad = np.flatnonzero(np.diff(clock) <= 0) if clock is not None else []
        if len(bad):
            yield place.warning(
                "time_backwards", f"{key!r} does not increase in {counted(len(bad), 'step')}", np.asarray(bad) + 1
            )
    for feature in rows.info.features:
        capture = rows.column(feature.key) if feature.key.startswith(time_key("")) else None
        bad = np.flatnonzero(np.diff(capture) < 0) if capture is not None else []
        if len(bad):
            message = f"{feature.key!r} decreases in {counted(len(bad), 'row')}: frames arrived in the wrong order"
            yield place.warning("time_backwards", message, np.asarray(bad) + 1)


def _periods(place: EpisodePlace, rows: EpisodeRows, is_resampled: bool) -> Iterator[Finding]:
    key = rows.clock
    clock = rows.column(key) if key is not None else None
    if clock is None:
        return
    wanted = 1 / rows.info.frequency
    periods = np.diff(clock)
    is_gap = periods > (_GAP_OF_RESAMPLED if is_resampled else _GAP) * wanted
    if is_gap.any():
        missed = counted(int(np.sum(np.rint(periods[is_gap] / wanted) - 1)), "step")
        gaps = counted(int(is_gap.sum()), "gap")
        message = f"{gaps}, the longest {np.nanmax(periods):.3f} s; about {missed} missing"
        yield place.warning("time_gap", message, np.flatnonzero(is_gap) + 1)
    steady = periods[np.isfinite(periods) & ~is_gap]
    if key != SIMULATED_TIME and not is_resampled and len(steady) >= _FEW_ROWS:
        late = float(np.percentile(np.abs(steady - wanted), 99))
        if late > _JITTER * wanted:
            message = f"the loop misses its {rows.info.frequency:g} Hz: 1 step in 100 is off by {1e3 * late:.1f} ms"
            yield place.warning("time_jitter", message)


def _camera_flags(place: EpisodePlace, rows: EpisodeRows) -> Iterator[Finding]:
    for camera in rows.cameras:
        flags = rows.column(flags_key(camera))
        if flags is None:
            continue
        for flag, (kind, meaning) in _FLAGS.items():
            flagged = np.flatnonzero(flags & flag)
            if len(flagged):
                yield place.warning(kind, f"{camera!r}: {meaning}, in {counted(len(flagged), 'row')}", flagged)


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


def check_motion(place: EpisodePlace, rows: EpisodeRows) -> Iterator[Finding]:
    """Yield findings about the motion of an episode."""
    for key in rows.joints:
        joints = rows.column(key)
        if joints is None or joints.ndim != 2 or len(joints) < 2:
            continue
        joints = np.where(np.isfinite(joints), joints, np.nan)  # values that are not finite are reported elsewhere
        limits = rows.info.feature(key).limits
        if limits is not None:
            lower, upper = np.array(limits.lower), np.array(limits.upper)
            beyond = np.nan_to_num(np.maximum(lower - joints, joints - upper))
            outside = np.flatnonzero(beyond.max(axis=1) > _BEYOND)
            if len(outside):
                far = (beyond.max(axis=0) > _BEYOND).tolist()
                names = ", ".join(name for name, is_far in zip(limits.names, far, strict=True) if is_far)
                message = f"{key!r}: {names} up to {beyond.max():.3f} rad beyond the limits of {limits.arm}"
                yield place.warning("joint_limit", f"{message}, in {counted(len(outside), 'row')}", outside)
        jumps = _jumps(joints, rows.seconds_per_step(), limits)
        touched = np.flatnonzero(jumps.any(axis=1)) + 1
        if len(touched):
            steps = _steps(joints)
            by = (
                f"faster than {limits.arm} can move"
                if limits is not None
                else "out of proportion to the steps around it"
            )
            times = counted(len(touched), "step")
            message = f"{key!r} jumps by up to {steps[jumps].max():.2f} rad in a step, {by}, in {times}"
            yield place.warning("joint_jump", message, touched)


def _jumps(joints: NDArray[np.float64], seconds: NDArray[np.float64], limits: JointBounds | None) -> NDArray[np.bool_]:
    """Return which steps of which joints are impossible, shape (length - 1, dof)."""
    steps = _steps(joints)
    if limits is not None:
        return steps > _FASTER * np.array(limits.velocity) * seconds[:, None] + _NOISE
    # The median of the two steps before and after, so that a spike does not hide itself. Unknown steps count as long,
    # so that no other one stands out because of them.
    known = np.where(np.isfinite(np.diff(joints, axis=0)), steps, np.inf)
    padded = np.pad(known, ((2, 2), (0, 0)), mode="edge")
    around = np.median([padded[i : i + len(steps)] for i in (0, 1, 3, 4)], axis=0)
    return (steps > _OUTLIER * around) & (steps > _FASTEST * seconds[:, None] + _NOISE)


def _steps(joints: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.nan_to_num(np.abs(np.diff(joints, axis=0)))
