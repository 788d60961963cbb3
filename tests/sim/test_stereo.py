"""Stereo depth has the gaps that its geometry says, and those shares that are stated."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rcs import _core
from rcs.robots.cameras import REALSENSE_D435
from rcs.sim.noise import DARK, STEEP_LOSS, STEEPEST, CameraNoise

HEIGHT, WIDTH = 120, 320
FOCAL = 300.0
MATRIX = np.array([[FOCAL, 0.0, 159.5], [0.0, FOCAL, 59.5], [0.0, 0.0, 1.0]])
NARROW = replace(REALSENSE_D435, stereo_fovx=0.0)


def measured(depth: Any, brightness: int = 128, *, camera: Any = NARROW, seed: int = 1) -> np.ndarray[Any, Any]:
    """Return what is measured of a depth [mm] that has a shape to which (H, W) can be cut."""
    image = np.broadcast_to(np.asarray(depth, np.uint16), (HEIGHT, WIDTH)).copy()
    rgb = np.full((HEIGHT, WIDTH, 3), brightness, np.uint8)
    CameraNoise(camera, (WIDTH, HEIGHT), "eye").measure_depth(image, rgb, MATRIX, seed)
    return image


def wall(*, left: int, right: int, near: int = 500, far: int = 1500) -> np.ndarray[Any, Any]:
    """Return the depth of a board before a wall, (W,) [mm]."""
    depth = np.full(WIDTH, far)
    depth[left:right] = near
    return depth


def test_a_board_has_its_shadow_on_its_left_as_wide_as_the_difference_of_disparities() -> None:
    lost = (measured(wall(left=150, right=200)) == 0).mean(axis=0)
    width = FOCAL * REALSENSE_D435.stereo_baseline * (1 / 0.5 - 1 / 1.5)
    assert width == pytest.approx(20.0)
    assert lost[131:149].min() == 1.0, "all of the shadow"
    assert lost[:128].max() < 0.02, "nothing left of it"
    assert lost[152:198].max() < 0.02, "nothing of the board"
    assert lost[203:].max() < 0.02, "nothing on its right"


def test_what_is_seen_past_a_thin_pole_by_both_eyes_is_measured() -> None:
    lost = (measured(wall(left=150, right=154)) == 0).mean(axis=0)
    # The right eye has the pole in front of four columns only.
    assert 2 <= (lost[100:149] > 0.9).sum() <= 6
    assert lost[137:148].max() < 0.02, "between pole and shadow"


def test_a_slope_that_both_eyes_see_has_no_shadow() -> None:
    depth = np.linspace(700, 1500, WIDTH)
    for slope in (depth, depth[::-1]):
        assert (measured(slope) == 0).mean() < 0.01


def test_the_left_edge_that_the_right_eye_does_not_see_has_no_depth() -> None:
    camera = replace(REALSENSE_D435, stereo_fovx=2 * np.arctan(160 / FOCAL))
    for depth in (400, 1000):
        lost = (measured(depth, camera=camera) == 0).mean(axis=0)
        disparity = FOCAL * camera.stereo_baseline / (1e-3 * depth)
        assert lost[: round(disparity) - 2].min() == 1.0
        assert lost[round(disparity) + 2 :].max() < 0.02
    assert (measured(1000) == 0).mean() < 0.01, "where the field of view is not known"


def test_half_of_the_pixels_beside_an_edge_and_on_grazing_surfaces_have_no_depth() -> None:
    depth = np.full((HEIGHT, WIDTH), 1500)
    depth[60:] = 1000
    lost = (measured(depth) == 0).mean(axis=1)
    assert lost[59:61].mean() == pytest.approx(STEEP_LOSS, abs=0.06)
    assert max(lost[:59].max(), lost[61:].max()) < 0.02
    # A floor that is seen from `height` above it: grazing where the ray is nearer to it than 90° - STEEPEST.
    for angle, share in ((STEEPEST + 0.05, STEEP_LOSS), (STEEPEST - 0.05, 0.0)):
        per_row = np.tan(angle) / FOCAL
        rows = 1000 * np.exp(per_row * np.arange(HEIGHT))[:, None]
        found = (measured(np.minimum(rows, 60000)) == 0).mean()
        assert found == pytest.approx(share, abs=0.02)


def test_the_darker_the_more_is_lost() -> None:
    for brightness in (0, 3, 9, 12, 40):
        expected = max(0.0, 1 - brightness / DARK)
        assert (measured(800, brightness) == 0).mean() == pytest.approx(expected, abs=0.02)


def test_too_near_too_far_and_nothing_are_no_reading() -> None:
    assert not measured(90).any()
    assert not measured(0).any()
    # At 60 m the error is larger than what 16 bits can tell: no value wraps around.
    far = measured(65000)
    assert 0.2 < (far == 0).mean() < 0.8


def test_shapes_that_do_not_fit_are_refused() -> None:
    depth, rgb = np.ones((4, 4), np.uint16), np.zeros((4, 5, 3), np.uint8)
    with pytest.raises(ValueError, match="one size"):
        CameraNoise(NARROW, (5, 4), "eye").measure_depth(depth, rgb, MATRIX, 0)
    with pytest.raises(ValueError, match="256"):
        _core.add_colour_noise(rgb, np.zeros(3, np.int8), 0)
