"""Limits on rows of numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rcs._core import clip_rows, limit_rows
from rcs.errors import InvalidSetup


@pytest.mark.parametrize("wrong", [-1e-9, -np.inf, np.nan])
def test_a_limit_that_is_negative_or_not_a_number_is_refused(wrong: float) -> None:
    row, step = np.zeros((2, 2)), np.array([0.1, 0.1])
    with pytest.raises(InvalidSetup, match="max_step must not be negative or NaN"):
        limit_rows(row + 1, row, row, np.array([0.1, wrong]), step, 0.0)
    with pytest.raises(InvalidSetup, match="max_lead must not be negative or NaN"):
        limit_rows(row + 1, row, row, step, np.array([0.1, wrong]), 0.0)


def test_limits_may_be_zero_or_infinite() -> None:
    row = np.zeros((1, 2))
    for step, expected in (([0.0, np.inf], [[0.0, 0.0]]), ([0.5, np.inf], [[0.5, 0.5]])):
        target, is_cut = limit_rows(row + 1, row, row, np.array(step), np.full(2, np.inf), 0.0) or (None, None)
        np.testing.assert_array_equal(target, expected)
        np.testing.assert_array_equal(is_cut, [True])
    assert limit_rows(row + 1, row, row, np.full(2, np.inf), np.full(2, np.inf), 0.0) is None


@pytest.mark.parametrize("value", [np.datetime64("2020"), np.timedelta64(3), np.array(["2020"], "datetime64[s]")])
def test_dates_are_no_numbers(value: Any) -> None:
    with pytest.raises(TypeError, match="incompatible"):
        clip_rows(value, np.zeros(1), np.ones(1), 0.0)
