"""Scaled images are smooth, keep their brightness, and have the same bits whatever the order of the sums."""

from __future__ import annotations

import numpy as np
import pytest
from rcs_data.errors import InvalidSetup
from rcs_data.read.scale import Scaler


def scaled(image: np.ndarray, target: tuple[int, int]) -> np.ndarray:
    out = np.empty((*target, 3), np.uint8)
    Scaler(image.shape[:2], target)(image, out)
    return out


@pytest.mark.parametrize("target", [(7, 9), (30, 40), (97, 61), (1, 1)])
@pytest.mark.parametrize("value", [0, 1, 127, 255])
def test_a_plain_image_stays_plain(target: tuple[int, int], value: int) -> None:
    assert np.unique(scaled(np.full((30, 40, 3), value, np.uint8), target)).tolist() == [value]


def test_the_same_size_changes_nothing() -> None:
    image = np.random.default_rng(0).integers(0, 256, (30, 40, 3), np.uint8)
    np.testing.assert_array_equal(scaled(image, (30, 40)), image)


@pytest.mark.parametrize("target", [(24, 24), (64, 32), (96, 192)])
def test_a_slope_stays_a_slope(target: tuple[int, int]) -> None:
    def slope(height: int, width: int) -> np.ndarray:
        rows, columns = (np.arange(n) + 0.5 for n in (height, width))
        plane = 60 * rows[:, None] / height + 120 * columns / width + 20
        return np.stack([plane, plane[::-1], plane[:, ::-1]], axis=2)

    found = scaled(np.rint(slope(96, 96)).astype(np.uint8), target)
    inner = (slice(target[0] // 8, -target[0] // 8), slice(target[1] // 8, -target[1] // 8))  # edges end the slope
    np.testing.assert_allclose(found[inner], slope(*target)[inner], atol=1.1)


def test_the_mean_brightness_stays() -> None:
    image = np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)
    for target in ((32, 32), (16, 48), (128, 128)):
        np.testing.assert_allclose(scaled(image, target).mean((0, 1)), image.mean((0, 1)), atol=2.0)


def test_a_fine_pattern_becomes_grey_and_does_not_flicker() -> None:
    image = np.zeros((64, 64, 3), np.uint8)
    image[:, ::2] = 200
    assert np.ptp(scaled(image, (64, 16))[:, 2:-2].astype(int)) <= 2


def test_all_sums_are_exact_in_single_precision() -> None:
    # The same in 64 bit integers, where nothing is rounded but where the text says so.
    image = np.random.default_rng(1).integers(0, 256, (50, 70, 3), np.uint8)
    image[:10] = 255
    scaler = Scaler((50, 70), (31, 83))
    rows, columns = np.zeros((31, 50), np.int64), np.zeros((83, 70), np.int64)
    for matrix, taps in ((rows, scaler._rows), (columns, scaler._columns)):
        for chosen, weights in taps:
            matrix[np.arange(len(matrix)), chosen] += weights.astype(np.int64)
    lines = np.rint(np.einsum("ij,jkc->ikc", rows, image.astype(np.int64)) / 256).astype(np.int64)
    expected = np.rint(np.einsum("ij,kjc->kic", columns, lines) / 65536)
    np.testing.assert_array_equal(scaled(image, (31, 83)), expected)


def test_no_size_is_zero() -> None:
    with pytest.raises(InvalidSetup, match="at least 1"):
        Scaler((10, 10), (0, 5))
