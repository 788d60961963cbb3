from __future__ import annotations

import numpy as np

from rcs.robots.tactile import DIGIT
from rcs.sim.gel import Gel, GelLight

GEL = Gel(DIGIT)


def test_the_gel_protrudes_in_the_middle_and_is_lowest_at_its_corners() -> None:
    x, y, z = DIGIT.gel_center
    assert GEL.surface(np.array(y), np.array(z)) == x
    corner = GEL.surface(np.array(y + DIGIT.gel_width / 2), np.array(z - DIGIT.gel_height / 2))
    np.testing.assert_allclose(corner, x - DIGIT.gel_bulge, atol=1e-12)


def test_every_ray_meets_the_rest_surface_at_its_depth() -> None:
    slope_y, slope_z = GEL.slopes
    x0, y0, z0 = DIGIT.camera_position
    depth = GEL.depth_at_rest(slope_y, slope_z)
    np.testing.assert_allclose(x0 + depth, GEL.surface(y0 + depth * slope_y, z0 + depth * slope_z), atol=1e-12)
    assert GEL.rest.shape == (240, 320)


def test_pixels_and_slopes_are_inverse_to_each_other() -> None:
    rows, columns = GEL.pixels(*GEL.slopes)
    np.testing.assert_allclose(rows[:, 0], np.arange(240), atol=1e-9)
    np.testing.assert_allclose(columns[0], np.arange(320), atol=1e-9)


def test_what_does_not_touch_displaces_nothing() -> None:
    assert not GEL.displacement(np.full(GEL.grid, np.inf)).any()
    assert not GEL.displacement(GEL.ray_rest.copy()).any()


def test_what_presses_everywhere_alike_displaces_everything_alike() -> None:
    displacement = GEL.displacement(GEL.ray_rest - 0.001)
    np.testing.assert_allclose(displacement, 0.001, atol=1e-8)


def test_more_pressure_never_displaces_less() -> None:
    rng = np.random.default_rng(0)
    depth = GEL.ray_rest - rng.uniform(-0.002, 0.002, GEL.grid)
    more = depth - rng.uniform(0.0, 0.001, GEL.grid)
    assert (GEL.displacement(more) >= GEL.displacement(depth) - 1e-9).all()


def test_the_background_comes_from_lights_of_three_colours() -> None:
    background = GelLight(DIGIT, GEL).background
    assert background.min() > 20
    assert background.max() < 250
    # Upright, red is at 30 degrees, green at 150 and blue at 270: here they lie on their side.
    red, green, blue = (np.unravel_index(background[..., channel].argmax(), (240, 320)) for channel in range(3))
    assert red[0] < 120 < green[0]
    assert blue[1] < 160 < red[1]


def test_drawing_a_gel_at_rest_gives_the_background() -> None:
    light = GelLight(DIGIT, GEL)
    np.testing.assert_array_equal(light.draw(np.zeros((240, 320), np.float32)), light.background)
