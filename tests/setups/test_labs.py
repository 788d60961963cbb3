"""The view of a fixed camera of a lab in a square picture: where tasks take place, and what lifts there."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from numpy.typing import ArrayLike

from rcs.devices import lookup
from rcs.envs.setup import Setup
from rcs.kinematics import kinematics_of
from rcs.setups.lab import CameraMount, lab_of
from rcs.setups.make import resolve
from rcs.spatial import Pose

FIXED = [
    (robot, name)
    for robot in lookup.names("lab")
    for name, mount in lab_of(robot).cameras.items()
    if mount.on_gripper_of is None
]


def seen(mount: CameraMount, point: ArrayLike) -> np.ndarray:
    """Return where a point of the scene is in a square picture: from -1, left and top, to 1."""
    camera = lookup.find("camera", mount.camera)
    fovy = camera.fovy
    if mount.calibration is not None and mount.calibration.intrinsics is not None:
        fovy = 2 * np.arctan(mount.calibration.intrinsics.height / 2 / mount.calibration.intrinsics.fy)
    optical = Pose(mount.optical.translation, mount.optical.quaternion).matrix
    x, y, z, _ = np.linalg.inv(optical) @ [*np.asarray(point, np.float64), 1.0]
    return np.array([x, y]) / z / np.tan(fovy / 2)


@pytest.mark.parametrize(("robot", "camera"), FIXED)
def test_objects_are_in_view_wherever_they_start_and_when_they_are_lifted(robot: str, camera: str) -> None:
    lab = lab_of(robot)
    (x, y), (width, depth) = lab.area.center, lab.area.size
    lifted = 0.2 * lab.area.object_scale
    for i, j, height in product((-0.5, 0.5), (-0.5, 0.5), (0.0, lifted)):
        assert (np.abs(seen(lab.cameras[camera], (x + i * width, y + j * depth, height))) < 1.0).all()


@pytest.mark.parametrize("robot", ["fr3", "so101", "xarm7"])
def test_the_hand_is_in_view_at_home(robot: str) -> None:
    (one,) = resolve(Setup(task="Free", robot=robot)).robots
    mount = next(mount for mount in lab_of(robot).cameras.values() if mount.on_gripper_of is None)
    kinematics = kinematics_of(one.arm, one.end_effector)
    flange = kinematics_of(one.arm, None)
    home = np.array(one.arm.home)
    for pose in (kinematics.forward(home), flange.forward(home)):
        assert (np.abs(seen(mount, pose.translation)) < 0.95).all()
