"""The camera models: optical frame, field of view, intrinsics, housing."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.robots.camera import CameraDescription
from rcs.robots.cameras import REALSENSE_D405, REALSENSE_D435, REALSENSE_D435I, USB_WEBCAM

CAMERAS = [REALSENSE_D405, REALSENSE_D435, REALSENSE_D435I, USB_WEBCAM]
every_camera = pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: c.name)


def load(camera: CameraDescription) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_path(str(camera.mjcf))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


@every_camera
def test_the_body_frame_is_the_optical_frame(camera: CameraDescription) -> None:
    _, data = load(camera)
    seen = data.camera(camera.camera)
    body = data.body(camera.base_body)
    np.testing.assert_allclose(seen.xpos, body.xpos, atol=1e-15)
    # MuJoCo's cameras have y up and look along -z; optical frames have y down and look along +z.
    turned = seen.xmat.reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])
    np.testing.assert_allclose(turned, body.xmat.reshape(3, 3), atol=1e-12)


@every_camera
def test_field_of_view_of_model_description_and_intrinsics_agree(camera: CameraDescription) -> None:
    model, _ = load(camera)
    assert math.radians(model.camera(camera.camera).fovy[0]) == pytest.approx(camera.fovy, abs=1e-12)
    for mode in camera.modes:
        matrix = camera.intrinsics(mode.width, mode.height)
        # The upper edge of the image, half a pixel above the first row's centre.
        assert 2.0 * math.atan((matrix[1, 2] + 0.5) / matrix[1, 1]) == pytest.approx(camera.fovy, abs=1e-12)
        assert matrix[0, 0] == matrix[1, 1]


@every_camera
def test_the_optical_axis_meets_the_centre_of_the_image(camera: CameraDescription) -> None:
    for width, height in ((84, 84), (224, 224), (640, 480)):
        pixel = camera.intrinsics(width, height) @ [0.0, 0.0, 1.0]
        np.testing.assert_allclose(pixel, [(width - 1) / 2, (height - 1) / 2, 1.0])


@every_camera
def test_halving_the_image_halves_the_focal_length(camera: CameraDescription) -> None:
    full, half = camera.intrinsics(640, 480), camera.intrinsics(320, 240)
    assert half[0, 0] == pytest.approx(full[0, 0] / 2)


@every_camera
def test_an_image_wider_than_the_sensor_is_refused(camera: CameraDescription) -> None:
    with pytest.raises(InvalidSetup, match="wider than the sensor"):
        camera.intrinsics(1000, 400)
    with pytest.raises(InvalidSetup, match="positive"):
        camera.intrinsics(0, 480)


def test_the_d435_has_the_focal_length_that_calibrated_cameras_report() -> None:
    # Factory calibrations in public reports: 606 to 617 px at 640 x 480, 909 to 925 px at 1280 x 720.
    assert REALSENSE_D435.intrinsics(640, 480)[1, 1] == pytest.approx(612.0, abs=6.0)
    assert REALSENSE_D435.intrinsics(1280, 720)[1, 1] == pytest.approx(917.0, abs=10.0)


def test_the_d435i_sees_what_the_d435_sees() -> None:
    for width, height in ((640, 480), (1280, 720)):
        np.testing.assert_array_equal(
            REALSENSE_D435I.intrinsics(width, height), REALSENSE_D435.intrinsics(width, height)
        )
    assert load(REALSENSE_D435I)[0].body("camera").mass[0] == 0.072


def test_the_webcam_has_no_depth_and_streams_at_up_to_30_frames_per_second() -> None:
    assert not USB_WEBCAM.has_depth
    assert {mode.rates[-1] for mode in USB_WEBCAM.modes} == {30}


@every_camera
def test_the_tripod_hole_lies_on_the_underside_of_the_housing(camera: CameraDescription) -> None:
    model, _ = load(camera)
    (housing,) = np.flatnonzero(model.geom_group == 3)
    offset = np.array(camera.mount_hole_in_optical.translation) - model.geom_pos[housing]
    size = model.geom_size[housing]
    assert abs(offset[0]) < 1e-12
    assert offset[1] == pytest.approx(size[1], abs=1e-12)
    assert abs(offset[2]) < size[2]


@every_camera
def test_the_mount_frame_looks_along_x_with_z_up(camera: CameraDescription) -> None:
    x, y, z, w = camera.mount_hole_in_optical.quaternion
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, [w, x, y, z])
    np.testing.assert_allclose(matrix.reshape(3, 3)[:, 0], [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(matrix.reshape(3, 3)[:, 2], [0.0, -1.0, 0.0], atol=1e-12)


@every_camera
def test_nothing_of_the_housing_stands_in_the_view(camera: CameraDescription) -> None:
    model, _ = load(camera)
    fovx = 2.0 * math.atan(camera.native_aspect * math.tan(camera.fovy / 2.0))
    # A shape that encloses the optical centre is not drawn: only its inner faces point at the camera.
    before = [geom for geom in np.flatnonzero(model.geom_group == 2) if not encloses_optical_centre(model, geom)]
    rng = np.random.default_rng(4)
    for _ in range(200):
        u, v = np.tan([fovx / 2.0, camera.fovy / 2.0]) * rng.uniform(-1.0, 1.0, 2)
        for geom in before:
            kind, size = int(model.geom_type[geom]), model.geom_size[geom]
            pose = (model.geom_pos[geom], rotation_of(model, geom))
            assert mujoco.mju_rayGeom(*pose, size, np.zeros(3), np.array([u, v, 1.0]), kind, None) < 0.0


def rotation_of(model: mujoco.MjModel, geom: int) -> NDArray[np.float64]:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, model.geom_quat[geom])
    return matrix


def encloses_optical_centre(model: mujoco.MjModel, geom: int) -> bool:
    centre = rotation_of(model, geom).reshape(3, 3).T @ -model.geom_pos[geom]
    size = model.geom_size[geom]
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
        return bool(np.all(np.abs(centre) <= size))
    return bool(np.hypot(centre[0], centre[1]) <= size[0] and abs(centre[2]) <= size[1])
