"""A camera and where it is fixed."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from rcs_data.record import Record, converted

from rcs.devices import lookup
from rcs.robots.calibration import CameraCalibration
from rcs.robots.description import CameraDescription
from rcs.robots.mount import Mount
from rcs.spatial import Pose


def _camera(given: str | CameraDescription) -> str:
    return lookup.name_of("camera", given)


class CameraMount(Record):
    """A camera and where it is fixed."""

    camera: str = converted(converter=_camera)
    """Name of the camera's description, `module:NAME`, or the description itself."""
    optical: Mount
    """Pose of the optical frame (x right, y down, z forward) in the parent's frame."""
    on_gripper_of: str | None = None
    """Name of the robot whose gripper's base body is the parent; None for the scene."""
    calibration: CameraCalibration | None = None
    """Calibrated intrinsics and pose covariance; None for the data sheet's."""


def looking(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> Mount:
    """Return the mount of an optical frame at `eye` that looks at `target`, both in the parent's frame [m].

    Args:
        eye: Position of the camera.
        target: A point in the middle of the picture.
        up: Direction that is up in the picture.
    """
    forward = np.subtract(target, eye)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, np.asarray(up, np.float64))
    right = right / np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    x, y, z, w = Pose.from_matrix(matrix).quaternion
    ex, ey, ez = np.asarray(eye, np.float64)
    return Mount(translation=(float(ex), float(ey), float(ez)), quaternion=(float(x), float(y), float(z), float(w)))
