"""The lag is the shift that was put in, whatever it is, and the error is what is left."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rcs.envs.observers.tracking import LEAST_MOTION, Tracking
from rcs.errors import InvalidSetup

GRID = 0.002


def path(time: np.ndarray | float) -> np.ndarray:
    return np.stack([0.2 * np.sin(2.0 * np.asarray(time)), 0.1 * np.cos(3.1 * np.asarray(time))], axis=-1)


def followed(lag: float, *, noise: float = 0.0, seconds: float = 4.0, seed: int = 0) -> Tracking:
    tracking, random = Tracking(2, grid=GRID), np.random.default_rng(seed)
    tracking.start(0.0, path(0.0))
    time = 0.0
    for due in np.arange(1 / 30, seconds, 1 / 30):
        while time + GRID <= due:
            time += GRID
            tracking.expect(time, path(time))
        tracking.measure(time, path(time - lag) + random.normal(0.0, noise, 2) if noise else path(time - lag))
    return tracking


@settings(max_examples=25, deadline=None)
@given(lag=st.floats(0.0, 0.19), seed=st.integers(0, 99))
def test_the_lag_is_found_to_within_a_millisecond_and_the_noise_is_what_is_left(lag: float, seed: int) -> None:
    tracking = followed(lag, noise=5e-4, seed=seed)
    assert tracking.find_lag() == pytest.approx(lag, abs=1e-3)
    np.testing.assert_allclose(tracking.rms(tracking.lag or 0.0), 5e-4, rtol=0.35)


def test_without_noise_the_lag_is_exact_and_nothing_is_left() -> None:
    tracking = followed(0.05)
    assert tracking.find_lag() == pytest.approx(0.05, abs=1e-5)
    assert tracking.rms(0.05).max() < 1e-5
    assert tracking.deviation(0.04, 0.06).max() < 1e-5


def test_an_offset_is_no_lag() -> None:
    tracking = followed(0.03)
    for _, joints in tracking._measured:
        joints[:] += 0.01  # as measured by an arm that was calibrated wrongly
    assert tracking.find_lag() == pytest.approx(0.03, abs=5e-3)
    np.testing.assert_allclose(tracking.rms(0.03), 0.01, rtol=0.05)


def test_where_nothing_moves_there_is_no_lag() -> None:
    tracking = Tracking(2, grid=GRID)
    tracking.start(0.0, np.zeros(2))
    for step in range(1, 1000):
        tracking.expect(step * GRID, np.full(2, 0.1 * LEAST_MOTION * np.sin(step / 50)))
        tracking.measure(step * GRID, np.zeros(2))
    assert tracking.find_lag() is None


def test_expected_joints_are_those_of_their_moment_however_long_it_goes_on() -> None:
    tracking = Tracking(2, grid=GRID, window=0.5, longest_lag=0.1)
    tracking.start(0.0, path(0.0))
    for step in range(1, 3000):
        tracking.expect(step * GRID, path(step * GRID))
    times = 2999 * GRID - np.array([0.0, 0.0011, 0.3, 0.55])
    np.testing.assert_allclose(tracking.expected_at(times), path(times), atol=1e-5)


def test_the_deviation_is_the_distance_to_the_path_between_two_lags() -> None:
    tracking = followed(0.0)
    time, _ = tracking._measured[-1]
    tracking.measure(time, path(time - 0.08))
    deviations = [tracking.deviation(0.0, latest).max() for latest in (0.0, 0.03, 0.06, 0.1)]
    assert all(before > after for before, after in pairwise(deviations))
    assert deviations[-1] < 1e-4 < deviations[0]


@pytest.mark.parametrize("times", [{"window": 0.1}, {"longest_lag": 0.001}, {"grid": 0.0}])
def test_times_that_make_no_sense_are_refused(times: dict[str, float]) -> None:
    with pytest.raises(InvalidSetup, match="valid is 0 < grid"):
        Tracking(2, **{"grid": GRID, **times})
