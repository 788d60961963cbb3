"""Limits on rows of numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rcs._core import clip_rows, limit_rows
from rcs.errors import InvalidSetup

FREE = np.full(2, np.inf)


def limited(
    asked: Any, last: Any, step: Any, lead: Any = FREE, *, upper: Any = FREE, max_return: float = np.inf
) -> Any:
    """Limit targets of an arm that has followed the last one."""
    return limit_rows(asked, last, last, np.array(step), np.array(lead), -FREE, np.array(upper), max_return, 0.0)


@pytest.mark.parametrize("wrong", [-1e-9, -np.inf, np.nan])
def test_a_limit_that_is_negative_or_not_a_number_is_refused(wrong: float) -> None:
    row, step = np.zeros((2, 2)), np.array([0.1, 0.1])
    with pytest.raises(InvalidSetup, match="max_step must not be negative or NaN"):
        limited(row + 1, row, [0.1, wrong], step)
    with pytest.raises(InvalidSetup, match="max_lead must not be negative or NaN"):
        limited(row + 1, row, step, [0.1, wrong])
    with pytest.raises(InvalidSetup, match="max_return must be positive"):
        limited(row + 1, row, step, max_return=wrong)


def test_limits_may_be_zero_or_infinite() -> None:
    row = np.zeros((1, 2))
    for step, expected in (([0.0, np.inf], [[0.0, 0.0]]), ([0.5, np.inf], [[0.5, 0.5]])):
        target, is_cut = limited(row + 1, row, step) or (None, None)
        np.testing.assert_array_equal(target, expected)
        np.testing.assert_array_equal(is_cut, [True])
    assert limited(row + 1, row, FREE) is None


def test_a_joint_out_of_its_range_comes_back_slowly_and_takes_the_others_along() -> None:
    last = np.array([[0.0, 1.5], [0.0, 1.0]])  # the second joint of the first row is out
    target, is_cut = limited(np.zeros((2, 2)) + [0.2, 0.5], last, [1.0, 1.0], upper=[1.0, 1.0], max_return=0.1)
    np.testing.assert_allclose(target, [[0.02, 1.4], [0.2, 0.5]])
    np.testing.assert_array_equal(is_cut, [True, False])


@pytest.mark.parametrize("value", [np.datetime64("2020"), np.timedelta64(3), np.array(["2020"], "datetime64[s]")])
def test_dates_are_no_numbers(value: Any) -> None:
    with pytest.raises(TypeError, match="incompatible"):
        clip_rows(value, np.zeros(1), np.ones(1), 0.0)
