"""Statistics of a stream are those of all of it, however it was cut, and normalising can be undone."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rcs_data.errors import InvalidSetup
from rcs_data.read.statistics import RunningStatistics, Statistics


def of(values: np.ndarray, cuts: list[int] | None = None) -> Statistics:
    running = RunningStatistics(values.shape[1])
    for part in np.split(values, sorted(cuts or [])):
        running.add(part)
    return running.result()


def sample(rows: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    columns = [rng.normal(5, 1e-3, rows), rng.uniform(-1, 1, rows) ** 3, np.full(rows, 0.3), rng.integers(0, 2, rows)]
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("rows", [1, 2, 500, 60_000])
def test_they_are_those_of_the_whole(rows: int) -> None:
    values = sample(rows)
    found = of(values, [0, 1, rows // 3, rows // 2])
    assert found.count == rows
    np.testing.assert_allclose(found.mean, values.mean(axis=0), rtol=1e-11)
    np.testing.assert_allclose(found.std, values.std(axis=0), rtol=1e-6, atol=1e-12)
    np.testing.assert_array_equal([found.min, found.max], [values.min(axis=0), values.max(axis=0)])
    allowed = np.ptp(values, axis=0) * (0 if rows <= 16384 else 1 / 8000) + 1e-12
    for name, share in (("q01", 0.01), ("q99", 0.99)):
        assert (np.abs(getattr(found, name) - np.quantile(values, share, axis=0)) <= allowed).all()


@settings(max_examples=8, deadline=None)
@given(st.lists(st.integers(0, 40_000), max_size=6), st.integers(0, 5))
def test_quantiles_do_not_depend_on_order_or_cuts(cuts: list[int], seed: int) -> None:
    values = sample(40_000)
    mixed = np.random.default_rng(seed).permutation(values)
    for name in ("q01", "q99", "min", "max"):
        np.testing.assert_array_equal(getattr(of(mixed, cuts), name), getattr(of(values), name))


def test_an_outlier_does_not_blur_the_rest() -> None:
    values = np.append(np.random.default_rng(0).uniform(0, 1, 50_000), 1e9)[:, None]
    found = of(values)
    assert abs(found.q99[0] - np.quantile(values, 0.99)) < 1e-3


@pytest.mark.parametrize("by", ["mean_std", "min_max", "quantiles"])
def test_normalising_can_be_undone(by: str) -> None:
    values = sample(1000)
    found = of(values)
    normal = found.normalise(values, by)
    np.testing.assert_allclose(found.denormalise(normal, by), values, atol=1e-12)
    np.testing.assert_allclose(normal[:, 2], 0, atol=1e-9)  # always the same
    if by == "mean_std":
        np.testing.assert_allclose(normal[:, :2].mean(axis=0), 0, atol=1e-9)
        np.testing.assert_allclose(normal[:, :2].std(axis=0), 1)
    if by == "min_max":
        np.testing.assert_allclose([normal[:, :2].min(axis=0), normal[:, :2].max(axis=0)], [[-1, -1], [1, 1]])


def test_they_go_through_json() -> None:
    found = of(sample(100))
    again = Statistics.from_json(json.loads(json.dumps(found.to_json())))
    assert again.to_json() == found.to_json()
    with pytest.raises(InvalidSetup, match="Not statistics"):
        Statistics.from_json({"count": 3})


def test_what_cannot_be_counted_is_refused() -> None:
    running = RunningStatistics(2)
    with pytest.raises(InvalidSetup, match="no vectors"):
        running.result()
    with pytest.raises(InvalidSetup, match=r"\(3, 4\); expected \(rows, 2\)"):
        running.add(np.zeros((3, 4)))
    with pytest.raises(InvalidSetup, match="Number 1 of vector 0 is nan"):
        running.add(np.array([[0.0, np.nan]]))
    with pytest.raises(InvalidSetup, match="no normalisation 'median'"):
        of(np.zeros((3, 2))).normalise(np.zeros(2), "median")  # type: ignore[arg-type]


def test_a_floor_keeps_numbers_that_hardly_vary_from_being_blown_up() -> None:
    values = sample(1000)  # the first number has a spread of 0.001, the third has none
    found = of(values)
    moved = values + [0.05, 0.0, 0.05, 0.0]
    assert found.normalise(moved)[:, 0].min() > 40.0
    normal = found.normalise(moved, floor=0.05)
    np.testing.assert_allclose(normal[:, [0, 2]], 1.0, atol=0.1)
    np.testing.assert_array_equal(normal[:, [1, 3]], found.normalise(moved)[:, [1, 3]])
    np.testing.assert_allclose(found.denormalise(normal, floor=0.05), moved, atol=1e-12)
    own = np.array([0.1, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(found.normalise(moved, floor=own)[:, 0], 0.5 * normal[:, 0], atol=1e-12)


@pytest.mark.parametrize("floor", [-0.1, np.nan, np.inf, (0.1, 0.1)])
def test_a_floor_that_is_none_is_refused(floor: object) -> None:
    with pytest.raises(InvalidSetup, match=r"floor is .* valid is a number from 0, or one for each of 4"):
        of(np.zeros((3, 4))).normalise(np.zeros(4), floor=floor)  # type: ignore[arg-type]
