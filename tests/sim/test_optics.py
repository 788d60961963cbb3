"""A calibrated camera draws what its matrices and its distortion say, at any size."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.robots.camera import Calibration
from rcs.robots.cameras import PINHOLE
from rcs.robots.description import Mount
from rcs.sim import CameraPlacement, Scene, World
from rcs.sim.camera import SimCameras
from rcs.spatial import Intrinsics, deproject, distort

EYE = CameraPlacement(
    name="eye",
    camera=PINHOLE,
    parent_body="world",
    # A metre above the origin, looking straight down; x is the scene's x, y its -y.
    optical_in_parent=Mount(translation=(0.0, 0.0, 1.0), quaternion=(1.0, 0.0, 0.0, 0.0)),
)
PLAIN = Intrinsics(width=320, height=240, fx=300.0, fy=290.0, cx=171.3, cy=104.8)
LENSES = {
    "pinhole": (0.0,) * 5,
    "barrel": (-0.3, 0.1, 0.001, -0.002, 0.0),
    "pincushion": (0.25, 0.1, -0.001, 0.001, 0.02),
}
SIZES = [((320, 240), "fast"), ((320, 240), "full"), ((160, 120), "fast"), ((224, 224), "fast"), ((320, 180), "full")]
BALLS = [(x, y) for x in (-0.3, -0.1, 0.15, 0.28) for y in (-0.25, 0.0, 0.2)]
RADIUS = 0.02


def look(intrinsics: Intrinsics | None, size: tuple[int, int], *, fovy: float = 1.0, **options: Any) -> dict[str, Any]:
    """Return the frame of a camera over balls on a plane that is a metre below it."""
    scene = Scene(mujoco.MjSpec())
    scene.spec.visual.map.znear, scene.spec.stat.extent = 0.01, 1.0
    scene.spec.visual.headlight.ambient = [1.0, 1.0, 1.0]
    scene.spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], rgba=[0, 0, 0, 1])
    for i, (x, y) in enumerate(BALLS):
        scene.spec.worldbody.add_geom(
            name=f"ball {i}",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[RADIUS, 0.0005, 0],
            pos=[x, y, 0],
            rgba=[1, 1, 1, 1],
        )
    calibration = None if intrinsics is None else Calibration(intrinsics=intrinsics)
    eye = replace(EYE, calibration=calibration)
    scene.add_camera(eye)
    model = scene.compile()
    world = World(model)
    options = {"quality": "full", "has_depth": True, "has_segmentation": True, **options}
    cameras = SimCameras(world, [eye], size=size, **options)
    model.cam_fovy[:] = np.degrees(2 * np.arctan(fovy * np.tan(np.radians(model.cam_fovy) / 2)))
    frame = cameras.read()["eye"]
    cameras.close()
    return frame


def expected_pixels(frame: dict[str, Any]) -> np.ndarray[Any, Any]:
    """Return where OpenCV's model puts the balls, (n, 2)."""
    points = np.array([(x, -y) for x, y in BALLS])  # a metre in front of the eye
    k = frame["intrinsics"]
    return distort(points, frame["distortion"]) * (k[0, 0], k[1, 1]) + k[:2, 2]


def offsets(frame: dict[str, Any], size: tuple[int, int]) -> np.ndarray[Any, Any]:
    """Return by how much the balls are seen beside where they should be, in geoms and in colours, (n, 4) [px]."""
    rows, columns = np.indices(size[::-1])
    margin = 0.035 * frame["intrinsics"][0, 0]
    found: list[list[float]] = []
    for i, (column, row) in enumerate(expected_pixels(frame)):
        if margin < column < size[0] - margin and margin < row < size[1] - margin:
            is_ball = frame["geoms"] == i + 2
            near = np.hypot(columns - column, rows - row) < margin
            white = frame["rgb"][..., 0].astype(float) * near
            found.append([])
            for weight in (is_ball, white):
                assert weight.sum() > 0
                found[-1] += [
                    (weight * columns).sum() / weight.sum() - column,
                    (weight * rows).sum() / weight.sum() - row,
                ]
    return np.array(found)


@pytest.mark.gl
@pytest.mark.parametrize(("size", "quality"), SIZES)
@pytest.mark.parametrize("lens", LENSES)
def test_what_is_at_a_known_place_is_seen_where_matrix_and_distortion_say(lens: str, size: Any, quality: Any) -> None:
    frame = look(replace(PLAIN, distortion=LENSES[lens]), size, quality=quality)
    errors = offsets(frame, size)
    assert len(errors) >= 6
    assert np.abs(errors).max() < 0.5
    assert np.abs(errors.mean(axis=0)).max() < 0.12, "neither colours nor numbers are shifted"
    assert frame["intrinsics"][0, 2] == pytest.approx(PLAIN.cut(size).cx)
    np.testing.assert_array_equal(frame["distortion"], LENSES[lens])


@pytest.mark.gl
@pytest.mark.parametrize("lens", LENSES)
def test_depth_of_a_distorted_picture_puts_every_pixel_on_the_floor(lens: str) -> None:
    frame = look(replace(PLAIN, distortion=LENSES[lens]), (320, 240))
    points = deproject(frame["depth"], frame["intrinsics"], frame["extrinsics"], distortion=frame["distortion"])
    floor = frame["segmentation"] == 1
    assert floor.mean() > 0.9
    np.testing.assert_allclose(points[floor][:, 2], 0.0, atol=0.001)


@pytest.mark.gl
@pytest.mark.parametrize("lens", LENSES)
def test_another_field_of_view_is_told_by_matrix_and_distortion(lens: str) -> None:
    frame = look(replace(PLAIN, distortion=LENSES[lens]), (320, 240), fovy=1.1)
    assert frame["intrinsics"][0, 0] == pytest.approx(PLAIN.fx / 1.1)
    assert np.abs(offsets(frame, (320, 240)).mean(axis=0)).max() < 0.12


@pytest.mark.gl
def test_a_centred_calibration_draws_the_very_picture_of_an_uncalibrated_camera() -> None:
    fovy = 2 * np.arctan(120 / 300)
    centred = Intrinsics(width=320, height=240, fx=300.0, fy=300.0, cx=159.5, cy=119.5)
    assert np.degrees(fovy) == pytest.approx(43.6028, abs=1e-3)
    frame, size = look(centred, (160, 120)), (160, 120)
    wanted = [[150.0, 0.0, 79.5], [0.0, 150.0, 59.5], [0.0, 0.0, 1.0]]
    np.testing.assert_allclose(frame["intrinsics"], wanted, atol=1e-9)
    barely = look(replace(centred, cx=159.5 + 1e-6), size)
    np.testing.assert_array_equal(frame["geoms"], barely["geoms"])


def test_a_lens_that_cannot_be_drawn_is_refused_with_the_cameras_name() -> None:
    for lens, text in (((-0.9, 0.0, 0.0, 0.0, 0.0), "eye.*folds"), ((-0.1, 0.0, 0.0, 0.0, 0.0), "without distortion")):
        wide = Intrinsics(width=4000, height=30, fx=2300.0, fy=2300.0, cx=2000.0, cy=15.0, distortion=lens)
        with pytest.raises(InvalidSetup, match=text):
            look(wide, (4000, 30))
