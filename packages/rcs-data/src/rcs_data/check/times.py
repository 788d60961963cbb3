"""Checks the times of an episode: clocks that run backwards, missing steps, a loop off its rate."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rcs_data.check.episode_rows import EpisodePlace, EpisodeRows
from rcs_data.check.report import Finding, counted
from rcs_data.files.feature import SIMULATED_TIME
from rcs_data.files.flags import FrameFlag, time_key

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
    for camera, keys in rows.cameras.items():
        flags = rows.flags(keys[0])
        if flags is None:
            continue
        for flag, (kind, meaning) in _FLAGS.items():
            flagged = np.flatnonzero(flags & flag)
            if len(flagged):
                yield place.warning(kind, f"{camera!r}: {meaning}, in {counted(len(flagged), 'row')}", flagged)
