"""The clock of a machine that sleeps: moments after that are fresh again, and those of a stalled network stay old."""

from __future__ import annotations

import numpy as np
import pytest

from rcs.errors import DeviceFault
from rcs.teleop.waking_clock import LATE, WakingClock

PERIOD = 1 / 72


def ages(clock: WakingClock, times: np.ndarray, arrivals: np.ndarray) -> np.ndarray:
    return np.array([there - clock.host_time(at, there) for at, there in zip(times, arrivals, strict=True)])


def test_a_clock_that_stood_still_while_its_machine_slept_is_told() -> None:
    clock, times = WakingClock(), PERIOD * np.arange(600)
    assert ages(clock, times[:200], times[:200] + 7.0).max() < 0.01
    with pytest.raises(DeviceFault, match=r"stood still for 60\.0 s"):
        ages(clock, times[200:], times[200:] + 67.0)


@pytest.mark.parametrize("seconds", [2.0, 10.0])
def test_moments_that_a_stalled_network_delivers_at_once_are_old(seconds: float) -> None:
    clock, times = WakingClock(), PERIOD * np.arange(2000)
    arrivals = times.copy()
    stalled = (times > 3.0) & (times < 3.0 + seconds)
    arrivals[stalled] = 3.0 + seconds + 1e-4 * np.arange(stalled.sum())
    found = ages(clock, times, np.maximum.accumulate(arrivals))
    assert found[stalled][0] == pytest.approx(seconds, abs=0.05)
    assert found[-1] < 0.01 < LATE
