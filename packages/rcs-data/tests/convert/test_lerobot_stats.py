"""Statistics: merged ones are those of all rows together, and image histograms know what the pixels know."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rcs_data.convert.lerobot_stats import QUANTILES, ImageHistogram, Moments, column_quantiles, quantiles


@given(st.lists(st.integers(1, 40), min_size=1, max_size=6), st.integers(0, 2**32 - 1))
def test_merged_moments_are_those_of_all_rows_together(lengths: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    parts = [rng.normal(1000, 0.5, (n, 3)) for n in lengths]
    merged = Moments.of(parts[0])
    for part in parts[1:]:
        merged = merged.merged(Moments.of(part))
    every = np.concatenate(parts)
    stats = merged.stats(quantiles(every))
    assert stats is not None
    np.testing.assert_allclose(stats["mean"], every.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(stats["std"], every.std(axis=0), rtol=1e-7, atol=1e-9)
    np.testing.assert_array_equal(stats["min"], every.min(axis=0))
    np.testing.assert_array_equal(stats["max"], every.max(axis=0))
    assert stats["count"] == [len(every)]


def test_times_that_were_not_measured_are_left_out() -> None:
    values = np.array([[np.nan], [1.0], [3.0]])
    stats = Moments.of(values).stats(quantiles(values))
    assert stats is not None
    assert (stats["mean"], stats["min"], stats["max"], stats["q50"]) == ([2.0], [1.0], [3.0], [2.0])


def test_what_was_never_measured_has_no_statistics() -> None:
    values = np.full((4, 2), np.nan)
    assert Moments.of(values).stats(quantiles(values)) is None


def test_quantiles_of_files_are_those_of_their_rows(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    parts = [rng.normal(size=(n, 4)).astype(np.float32) for n in (5, 30)]
    files: list[Path] = []
    for i, part in enumerate(parts):
        files.append(tmp_path / f"{i}.parquet")
        column = pa.FixedSizeListArray.from_arrays(pa.array(part.reshape(-1)), 4)
        pq.write_table(pa.table({"action": column}), files[-1])
    found = column_quantiles(files, "action")
    every = np.concatenate(parts).astype(np.float64)
    for name, share in QUANTILES.items():
        np.testing.assert_allclose(found[name], np.quantile(every, share, axis=0))


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
        np.testing.assert_allclose(np.ravel(stats[name]), np.quantile(pixels, share, axis=0))
    assert stats["count"] == [6]


def test_of_long_episodes_a_hundred_frames_are_counted() -> None:
    histogram = ImageHistogram(1000)
    for _ in range(1000):
        histogram.add(np.zeros((2, 2, 3), np.uint8))
    assert histogram.sampled == 100
