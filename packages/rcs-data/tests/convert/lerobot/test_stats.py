"""Statistics: merged ones are those of all rows together, and image histograms know what the pixels know."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rcs_data.convert.lerobot.stats import QUANTILES, DatasetStats, ImageHistogram, episode_stats


@given(st.lists(st.integers(1, 40), min_size=1, max_size=6), st.integers(0, 2**32 - 1))
def test_statistics_of_a_dataset_are_those_of_all_rows_together(lengths: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    parts = [rng.normal(1000, 0.5, (n, 3)).astype(np.float32) for n in lengths]
    total = DatasetStats()
    for part in parts:
        total.add({"action": part}, {})
    every = np.concatenate(parts).astype(np.float64)
    for stats in (total.to_json()["action"], episode_stats({"action": every})["action"]):
        np.testing.assert_allclose(stats["mean"], every.mean(axis=0), rtol=1e-12)
        np.testing.assert_allclose(stats["std"], every.std(axis=0), rtol=1e-7, atol=1e-9)
        np.testing.assert_array_equal(stats["min"], every.min(axis=0))
        np.testing.assert_array_equal(stats["max"], every.max(axis=0))
        for name, share in QUANTILES.items():
            np.testing.assert_allclose(stats[name], np.quantile(every, share, axis=0), rtol=1e-7)
        assert stats["count"] == [len(every)]


def test_times_that_were_not_measured_are_left_out() -> None:
    stats = episode_stats({"time": np.array([[np.nan], [1.0], [3.0]]), "other": np.array([[1], [2], [3]])})
    time = stats["time"]
    assert (time["mean"], time["min"], time["max"], time["q50"]) == ([2.0], [1.0], [3.0], [2.0])
    assert stats["other"]["mean"] == [2.0]


def test_what_was_never_measured_has_no_statistics() -> None:
    assert episode_stats({"time": np.full((4, 2), np.nan)}) == {}
    total = DatasetStats()
    total.add({"time": np.full((4, 2), np.nan)}, {})
    assert total.to_json() == {}


@pytest.mark.parametrize("shape", [(9, 7, 3), (40, 30, 3)])
def test_a_histogram_knows_what_the_pixels_know(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(2)
    images = rng.integers(10, 200, (6, *shape)).astype(np.uint8)
    apart = [ImageHistogram(3), ImageHistogram(3)]
    for i, image in enumerate(images):
        apart[i // 3].add(image)
    merged = ImageHistogram()
    for histogram in apart:
        merged.merge(histogram)
    stats = merged.stats()
    pixels = images.reshape(-1, 3) / 255
    assert np.shape(stats["mean"]) == (3, 1, 1)
    np.testing.assert_allclose(np.ravel(stats["mean"]), pixels.mean(axis=0))
    np.testing.assert_allclose(np.ravel(stats["std"]), pixels.std(axis=0))
    np.testing.assert_allclose(np.ravel(stats["min"]), pixels.min(axis=0))
    np.testing.assert_allclose(np.ravel(stats["max"]), pixels.max(axis=0))
    for name, share in QUANTILES.items():
        np.testing.assert_allclose(np.ravel(stats[name]), np.quantile(pixels, share, axis=0), atol=2 / 255)
    assert stats["count"] == [6]


def test_of_long_episodes_a_hundred_frames_are_counted() -> None:
    histogram = ImageHistogram(1000)
    for _ in range(1000):
        histogram.add(np.zeros((2, 2, 3), np.uint8))
    assert histogram.sampled == 100
