"""Where the cameras of a lab are and how they see, read from a calibration file.

A file is JSON, one entry per camera:

    {"cameras": {"side": {"translation": [0.66, 0.95, 0.50], "quaternion": [0.1, 0.2, 0.3, 0.9],
                          "width": 640, "height": 480, "fx": 617.0, "fy": 617.0}}}

The pose is that of the optical frame (x right, y down, z forward; m, xyzw) in the frame that carries the camera: the
scene, or the gripper's base body for a camera on a gripper. Intrinsics are in pixels of the given size. Pictures are
drawn with the focal length `fy`, square pixels and a centred principal point; without intrinsics, with those of the
camera's data sheet.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rcs.errors import InvalidSetup
from rcs.robots.description import Mount
from rcs.setups.lab import Lab

SQUARE = 0.02
"""Focal lengths that differ by more than this part are not those of square pixels."""


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """What a calibration says of one camera."""

    optical: Mount
    """Pose of the optical frame in the frame that carries the camera."""
    fovy: float | None
    """Vertical field of view [rad]; None for that of the data sheet."""


def read_calibration(path: str | Path) -> dict[str, Calibration]:
    """Read a calibration file.

    Args:
        path: The file.

    Raises:
        InvalidSetup: The file cannot be read, or does not say what it must; the message names the camera and the field.
    """
    try:
        content = json.loads(Path(path).read_text("utf-8"))
        cameras = content["cameras"]
        return {name: _calibration(name, about) for name, about in cameras.items()}
    except OSError as err:
        raise InvalidSetup(f"The calibration file {path} cannot be read: {err}.") from err
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
        name: replace(mount, optical=found[name].optical, fovy=found[name].fovy) if name in found else mount
        for name, mount in lab.cameras.items()
    }
    return replace(lab, cameras=cameras)


def _calibration(name: str, about: dict[str, Any]) -> Calibration:
    x, y, z = (float(value) for value in about["translation"])
    qx, qy, qz, qw = (float(value) for value in about["quaternion"])
    norm = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
    if not abs(norm - 1.0) < 1e-3:
        raise ValueError(f"camera {name!r}: quaternion has norm {norm:.4g}, a rotation needs 1")
    optical = Mount(translation=(x, y, z), quaternion=(qx / norm, qy / norm, qz / norm, qw / norm))
    if "fy" not in about:
        return Calibration(optical=optical, fovy=None)
    height, fx, fy = float(about["height"]), float(about["fx"]), float(about["fy"])
    if not (height > 0 and fy > 0 and abs(fx - fy) <= SQUARE * fy):
        raise ValueError(f"camera {name!r}: height {height}, fx {fx}, fy {fy}; pixels must be square, sizes positive")
    return Calibration(optical=optical, fovy=2.0 * math.atan(0.5 * height / fy))
