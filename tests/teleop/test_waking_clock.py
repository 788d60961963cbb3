"""The clock of a machine that sleeps: moments after that are fresh again, and those of a stalled network stay old."""

from __future__ import annotations

import numpy as np
import pytest

from rcs.teleop.waking_clock import LATE, WakingClock

PERIOD = 1 / 72


def ages(clock: WakingClock, times: np.ndarray, arrivals: np.ndarray) -> np.ndarray:
    """Return how old moments are when they arrive; NaN where the clock begins anew."""
    found = [clock.host_time(at, there) for at, there in zip(times, arrivals, strict=True)]
    return arrivals - np.array(found, np.float64)


def test_a_clock_that_stood_still_while_its_machine_slept_begins_anew() -> None:
    clock, times = WakingClock(), PERIOD * np.arange(600)
    assert ages(clock, times[:200], times[:200] + 7.0).max() < 0.01
    found = ages(clock, times[200:], times[200:] + 67.0)
    (slept,) = np.flatnonzero(np.isnan(found))
    assert found[slept - 1] == pytest.approx(60.0, abs=0.05)
    assert found[slept + 1 :].max() < 0.01, "and moments after that are fresh"


def test_a_clock_that_goes_back_begins_anew() -> None:
    clock = WakingClock()
    assert clock.host_time(5.0, 10.0) == 10.0
    assert clock.host_time(1.0, 11.0) is None
    assert clock.host_time(1.5, 11.5) == 11.5


@pytest.mark.parametrize("seconds", [2.0, 10.0])
def test_moments_that_a_stalled_network_delivers_at_once_are_old(seconds: float) -> None:
    clock, times = WakingClock(), PERIOD * np.arange(2000)
    arrivals = times.copy()
    stalled = (times > 3.0) & (times < 3.0 + seconds)
    arrivals[stalled] = 3.0 + seconds + 1e-4 * np.arange(stalled.sum())
    found = ages(clock, times, np.maximum.accumulate(arrivals))
    assert found[stalled][0] == pytest.approx(seconds, abs=0.05)
    assert found[-1] < 0.01 < LATE
