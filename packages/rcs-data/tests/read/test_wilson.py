"""The interval of a success rate holds what it should."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rcs_data.errors import InvalidSetup
from rcs_data.read.verdicts import wilson_interval

counts = st.integers(0, 2000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))


@given(counts)
def test_the_rate_lies_inside_and_the_bounds_are_rates(count: tuple[int, int]) -> None:
    successes, n = count
    low, high = wilson_interval(successes, n)
    assert 0 <= low < high <= 1
    if n:
        assert low <= successes / n <= high


@given(counts)
def test_failures_are_the_mirror_of_successes(count: tuple[int, int]) -> None:
    successes, n = count
    low, high = wilson_interval(successes, n)
    assert wilson_interval(n - successes, n) == pytest.approx((1 - high, 1 - low), abs=1e-12)


@given(counts.filter(lambda count: count[1] > 0))
def test_each_bound_is_a_rate_at_which_the_count_is_just_plausible(count: tuple[int, int]) -> None:
    successes, n = count
    for bound in wilson_interval(successes, n):
        if 0 < bound < 1:
            distance = abs(successes / n - bound) / math.sqrt(bound * (1 - bound) / n)
            assert distance == pytest.approx(1.959964, abs=1e-4)


def test_all_of_a_hundred_is_at_least_96_percent() -> None:
    assert wilson_interval(100, 100)[0] == pytest.approx(0.963, abs=5e-4)
    assert wilson_interval(300, 300)[0] == pytest.approx(0.987, abs=5e-4)


def test_the_true_rate_is_inside_about_95_times_in_100() -> None:
    wins = np.random.default_rng(0).binomial(60, 0.9, 2000)
    inside = [low <= 0.9 <= high for low, high in (wilson_interval(int(w), 60) for w in wins)]
    assert 0.92 < np.mean(inside) < 0.98


@pytest.mark.parametrize(("successes", "n"), [(2, 1), (-1, 3)])
def test_a_count_that_makes_no_sense_is_refused(successes: int, n: int) -> None:
    with pytest.raises(InvalidSetup, match="no sense"):
        wilson_interval(successes, n)
