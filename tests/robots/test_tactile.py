"""The DIGIT: its figures agree with its model, and what makes no sense is refused."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.robots.tactile import DIGIT


@pytest.fixture(scope="module")
def sensor() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(DIGIT.mjcf))


def test_the_gels_foremost_point_is_where_the_description_says(sensor: mujoco.MjModel) -> None:
    gel = sensor.geom(DIGIT.gel_geom)
    np.testing.assert_allclose(gel.pos + [gel.size[0], 0.0, 0.0], DIGIT.gel_center, atol=1e-12)


def test_nothing_stands_out_in_front_of_the_gel(sensor: mujoco.MjModel) -> None:
    # A plane that comes from the front meets the gel first, and no other geom within the gel's bulge.
    front = np.array([sensor.geom_pos[i, 0] + sensor.geom_size[i, 0] for i in range(sensor.ngeom)])
    collides = sensor.geom_group == 3
    gel = np.arange(sensor.ngeom) == sensor.geom(DIGIT.gel_geom).id
    assert front[gel] == pytest.approx(DIGIT.gel_center[0], abs=1e-12)
    assert front[collides & ~gel].max() == pytest.approx(DIGIT.gel_center[0] - DIGIT.gel_bulge, abs=1e-3)


def test_the_geom_that_touches_covers_the_gels_face(sensor: mujoco.MjModel) -> None:
    size = sensor.geom(DIGIT.gel_geom).size
    np.testing.assert_allclose(2.0 * size[1:], [DIGIT.gel_width, DIGIT.gel_height], atol=2e-3)


def test_the_camera_looks_at_the_middle_of_the_gel_from_behind() -> None:
    x, y, z = np.subtract(DIGIT.gel_center, DIGIT.camera_position)
    assert x > DIGIT.camera_znear
    assert y == z == 0.0
    seen = 2.0 * x * math.tan(DIGIT.camera_yfov / 2.0)
    assert 0.8 * DIGIT.gel_height < seen < DIGIT.gel_height


def test_the_lights_stand_evenly_on_a_ring_around_the_optical_axis() -> None:
    ring = np.array([light.position for light in DIGIT.lights])
    np.testing.assert_allclose(ring.mean(axis=0), [0.005, 0.0, 0.015], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(ring - ring.mean(axis=0), axis=1), 0.02)
    np.testing.assert_array_equal([light.color for light in DIGIT.lights], np.eye(3))


def test_the_image_is_upright_like_the_gel() -> None:
    width, height = DIGIT.image_size
    assert (width, height) == (240, 320)
    assert (width < height) == (DIGIT.gel_width < DIGIT.gel_height)


def test_figures_that_make_no_sense_are_refused() -> None:
    with pytest.raises(InvalidSetup, match="valid"):
        replace(DIGIT, gel_width=0.0)
    with pytest.raises(InvalidSetup, match="larger than a sphere"):
        replace(DIGIT, gel_curvature_radius=0.01)
    with pytest.raises(InvalidSetup, match="camera_yfov"):
        replace(DIGIT, camera_yfov=60.0)
    with pytest.raises(InvalidSetup, match="light"):
        replace(DIGIT, lights=())
    with pytest.raises(InvalidSetup, match="force_range"):
        replace(DIGIT, force_range=(100.0, 0.0))
