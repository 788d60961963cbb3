"""Where the cameras of a lab are and how they see, read from a calibration file.

A file is JSON, one entry per camera:

    {"cameras": {"side": {"translation": [0.66, 0.95, 0.50], "quaternion": [0.1, 0.2, 0.3, 0.9],
                          "width": 640, "height": 480, "fx": 617.0, "fy": 616.2, "cx": 321.4, "cy": 238.9,
                          "distortion": [0.11, -0.24, 0.001, 0.0, 0.0]}}}

The pose is that of the optical frame (x right, y down, z forward; m, xyzw) in the frame that carries the camera: the
scene, or the gripper's base body for a camera on a gripper. Intrinsics are in pixels of the given size, as OpenCV gives
them: the centre of the top left pixel is (0, 0), and `distortion` is k1, k2, p1, p2, k3. Without `cx` and `cy` the
principal point is the middle of the image, without `fx` pixels are square, without `fy` all are those of the camera's
data sheet. Pictures of another shape are cut out of the middle. `pose_covariance`, 6 x 6, is kept with recordings.
Any other key is refused.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from rcs.errors import InvalidSetup, UnknownName
from rcs.robots.calibration import CameraCalibration
from rcs.robots.description import Mount
from rcs.setups.lab import Lab
from rcs.spatial import Intrinsics

POSE = ("translation", "quaternion")
FOCAL = ("width", "height", "fx", "fy")
LENS = ("cx", "cy", "distortion")
COVARIANCE = "pose_covariance"


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """What a calibration says of one camera."""

    optical: Mount
    """Pose of the optical frame in the frame that carries the camera."""
    camera: CameraCalibration
    """How it sees."""


def read_calibration(path: str | Path) -> dict[str, Calibration]:
    """Read a calibration file.

    Args:
        path: The file.

    Raises:
        InvalidSetup: The file cannot be read, does not say what it must, or says what is not known here; the message
            names the camera and the field.
    """
    try:
        data = Path(path).read_bytes()
        content = json.loads(data)
        if unknown := sorted(set(content) - {"cameras"}):
            raise ValueError(f"unknown key {unknown[0]!r}; valid is 'cameras'")
        sha256 = hashlib.sha256(data).hexdigest()
        return {name: _calibration(name, about, sha256) for name, about in content["cameras"].items()}
    except OSError as err:
        raise InvalidSetup(f"The calibration file {path} cannot be read: {err}.") from err
    except InvalidSetup as err:
        raise InvalidSetup(f"{path} is not a calibration file: {err}") from err
    except (ValueError, KeyError, TypeError, AttributeError) as err:
        raise InvalidSetup(f"{path} is not a calibration file: {err!r}.") from err


def calibrated(lab: Lab, path: str | Path) -> Lab:
    """Return a lab whose cameras are where a calibration file says; cameras that it does not name stay as they are.

    Raises:
        InvalidSetup: The file is not valid, or names a camera that the lab does not have.
    """
    found = read_calibration(path)
    if unknown := sorted(set(found) - set(lab.cameras)):
        raise InvalidSetup(f"{path} has the cameras {unknown}, which this lab has not; it has {sorted(lab.cameras)}.")
    cameras = {
        name: replace(mount, optical=found[name].optical, calibration=found[name].camera) if name in found else mount
        for name, mount in lab.cameras.items()
    }
    return replace(lab, cameras=cameras)


def _calibration(name: str, about: dict[str, Any], sha256: str) -> Calibration:
    known = {*POSE, *FOCAL, *LENS, COVARIANCE}
    if unknown := sorted(set(about) - known):
        raise InvalidSetup(f"camera {name!r}: {UnknownName('key', unknown[0], known).message}")
    x, y, z = (float(value) for value in about["translation"])
    qx, qy, qz, qw = (float(value) for value in about["quaternion"])
    norm = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
    if not abs(norm - 1.0) < 1e-3:
        raise ValueError(f"camera {name!r}: quaternion has norm {norm:.4g}, a rotation needs 1")
    if not math.isfinite(x + y + z):
        raise ValueError(f"camera {name!r}: translation is {about['translation']}, valid are finite numbers [m]")
    optical = Mount(translation=(x, y, z), quaternion=(qx / norm, qy / norm, qz / norm, qw / norm))
    try:
        intrinsics = _intrinsics(about)
    except InvalidSetup as err:
        raise InvalidSetup(f"camera {name!r}: {err}") from err
    return Calibration(
        optical=optical,
        camera=CameraCalibration(
            intrinsics=intrinsics, pose_covariance=_covariance(name, about.get(COVARIANCE)), sha256=sha256
        ),
    )


def _intrinsics(about: dict[str, Any]) -> Intrinsics | None:
    if "fy" not in about:
        if given := [key for key in ("fx", *LENS) if key in about]:
            raise InvalidSetup(f"{given[0]!r} is given without 'fy'; give width, height and fy too.")
        return None
    width, height = (_whole(key, about[key]) for key in ("width", "height"))
    fy = float(about["fy"])
    return Intrinsics(
        width=width,
        height=height,
        fx=float(about.get("fx", fy)),
        fy=fy,
        cx=float(about.get("cx", (width - 1) / 2)),
        cy=float(about.get("cy", (height - 1) / 2)),
        distortion=tuple(about.get("distortion", ())),
    )


def _whole(key: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int | float) or value != int(value):
        raise InvalidSetup(f"{key} is {value!r}; valid is a whole number of pixels.")
    return int(value)


def _covariance(name: str, given: Any) -> tuple[tuple[float, ...], ...] | None:
    if given is None:
        return None
    matrix = np.asarray(given, np.float64)
    if matrix.shape != (6, 6) or not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T, rtol=1e-6, atol=0):
        raise ValueError(f"camera {name!r}: {COVARIANCE} must be symmetric, 6 x 6 and finite")
    if np.linalg.eigvalsh(matrix).min() < -1e-9 * max(np.trace(matrix), 0.0):
        raise ValueError(f"camera {name!r}: {COVARIANCE} has a negative variance along some direction")
    return tuple(tuple(float(value) for value in row) for row in matrix)
