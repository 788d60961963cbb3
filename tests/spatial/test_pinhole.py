"""How cameras map directions to pixels: distortion and its inverse, pictures that are cut out of others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcs.errors import InvalidSetup
from rcs.spatial import Intrinsics, distort, pixel_rays, undistort
from rcs.spatial.pinhole import five_coefficients

LENSES = [
    (0.0, 0.0, 0.0, 0.0, 0.0),
    (-0.28, 0.09, 0.0004, -0.0003, -0.01),
    (0.12, -0.24, 0.001, 0.0005, 0.08),
]
SEEN = Intrinsics(width=640, height=480, fx=600.0, fy=590.0, cx=335.0, cy=228.0, distortion=LENSES[1])


def test_distortion_is_opencvs() -> None:
    # One point by hand, with the formula of OpenCV's documentation.
    x, y, (k1, k2, p1, p2, k3) = 0.3, -0.2, LENSES[2]
    r2 = 0.13
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    expected = [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2), y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y]
    np.testing.assert_allclose(distort([x, y], LENSES[2]), expected, rtol=1e-14)


@pytest.mark.parametrize("lens", LENSES)
@given(points=st.lists(st.tuples(st.floats(-0.6, 0.6), st.floats(-0.5, 0.5)), min_size=1, max_size=20))
def test_undistort_is_the_inverse_of_distort(lens: tuple[float, ...], points: list[tuple[float, float]]) -> None:
    np.testing.assert_allclose(undistort(distort(points, lens), lens), points, atol=1e-11)


def test_a_lens_that_folds_its_picture_over_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="folds the picture"):
        undistort([[0.6, 0.5]], (-0.9, 0.0, 0.0, 0.0, 0.0))


def test_a_pixels_ray_comes_back_to_the_pixel() -> None:
    rays = pixel_rays(SEEN.matrix, (640, 480), SEEN.distortion)
    pixels = distort(rays, SEEN.distortion) * (SEEN.fx, SEEN.fy) + (SEEN.cx, SEEN.cy)
    columns, rows = np.meshgrid(np.arange(640), np.arange(480))
    np.testing.assert_allclose(pixels, np.stack([columns, rows], axis=-1), atol=1e-8)


@pytest.mark.parametrize("size", [(640, 480), (320, 240), (224, 224), (84, 84), (640, 360), (1280, 960)])
def test_a_cut_picture_shows_the_same_directions(size: tuple[int, int]) -> None:
    cut = SEEN.cut(size)
    scale = size[0] / min(640, 480 * size[0] / size[1])
    middle = (np.array([640, 480]) - np.array(size) / scale) / 2
    for pixel in ((0.0, 0.0), (10.0, 20.0), (size[0] - 1.0, size[1] - 1.0)):
        whole = (np.array(pixel) + 0.5) / scale - 0.5 + middle
        now = (np.array(pixel) - (cut.cx, cut.cy)) / (cut.fx, cut.fy)
        then = (whole - (SEEN.cx, SEEN.cy)) / (SEEN.fx, SEEN.fy)
        np.testing.assert_allclose(now, then, atol=1e-3)  # a cut is at whole pixels
    assert cut.distortion == SEEN.distortion


@pytest.mark.parametrize("given", [(0.1,), (0.1,) * 8, (float("nan"),) * 5, (0.0,) * 6])
def test_other_models_of_lenses_are_refused_and_never_shortened(given: tuple[float, ...]) -> None:
    with pytest.raises(InvalidSetup, match="k1, k2, p1, p2 and k3"):
        five_coefficients(given)


def test_four_coefficients_have_no_k3_and_zeros_after_the_fifth_say_nothing() -> None:
    assert five_coefficients((0.1, 0.2, 0.3, 0.4)) == (0.1, 0.2, 0.3, 0.4, 0.0)
    assert five_coefficients((0.1, 0.2, 0.3, 0.4, 0.5, 0.0, 0.0, 0.0)) == (0.1, 0.2, 0.3, 0.4, 0.5)
    assert five_coefficients(()) == five_coefficients(None) == (0.0,) * 5
    np.testing.assert_array_equal(pixel_rays(SEEN.matrix, (8, 6), None), pixel_rays(SEEN.matrix, (8, 6)))


@pytest.mark.parametrize("changes", [{"fx": 0.0}, {"width": 0}, {"cx": 700.0}, {"cy": float("nan")}])
def test_intrinsics_that_make_no_sense_are_refused(changes: dict[str, Any]) -> None:
    whole = {"width": 640, "height": 480, "fx": 600.0, "fy": 600.0, "cx": 320.0, "cy": 240.0}
    with pytest.raises(InvalidSetup):
        Intrinsics(**{**whole, **changes})


def test_a_skewed_matrix_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="camera matrix"):
        Intrinsics.of_matrix([[600.0, 1.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]], (640, 480))
