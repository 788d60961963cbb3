"""Commands of a gripper from measured openings."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rcs.rollout.recorded_motion import BARELY_CLOSED, SQUEEZE, THRESHOLD, squeezed, trend

OPENINGS = st.lists(st.floats(0.0, 1.0), min_size=2, max_size=40).map(lambda values: np.array(values)[:, None])


def test_a_grasp_is_closed_from_its_first_move_to_its_release() -> None:
    closing, opening = np.linspace(1.0, 0.4, 7), np.linspace(0.4, 1.0, 7)
    openings = np.concatenate([np.ones(5), closing, np.full(20, 0.4), opening])[:, None]
    told = trend(openings)[:, 0]
    np.testing.assert_array_equal(told[:6], 1.0)
    np.testing.assert_array_equal(told[7:33], 0.0)
    np.testing.assert_array_equal(told[34:], 1.0)


@given(OPENINGS, st.integers(0, 2**31))
def test_noise_below_the_threshold_tells_nothing(openings: np.ndarray, seed: int) -> None:
    still = np.broadcast_to(openings[:1], (50, 1))
    noisy = still + np.random.default_rng(seed).uniform(-THRESHOLD / 2, THRESHOLD / 2, still.shape) * 0.99
    assert len(set(trend(noisy)[:, 0])) == 1


@given(OPENINGS)
def test_a_trend_is_open_or_closed_and_nothing_else(openings: np.ndarray) -> None:
    assert set(trend(openings)[:, 0]) <= {0.0, 1.0}


@given(OPENINGS)
def test_squeezing_never_opens_and_never_by_more_than_its_margin(openings: np.ndarray) -> None:
    told = squeezed(openings)
    assert (told <= openings).all()
    assert (told >= np.maximum(openings - SQUEEZE, 0.0)).all()
    np.testing.assert_array_equal(told[openings > BARELY_CLOSED], openings[openings > BARELY_CLOSED])
