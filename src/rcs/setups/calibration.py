"""Where the cameras of a lab are and how they see, in a calibration file.

A file is JSON, one entry per camera:

    {"cameras": {"side": {"translation": [0.66, 0.95, 0.50], "quaternion": [0.1, 0.2, 0.3, 0.9],
                          "width": 640, "height": 480, "fx": 617.0, "fy": 616.2, "cx": 321.4, "cy": 238.9,
                          "distortion": [0.11, -0.24, 0.001, 0.0, 0.0]}}}

The pose is that of the optical frame (x right, y down, z forward; m, xyzw) in the frame that carries the camera: the
scene, or the gripper's base body for a camera on a gripper. Intrinsics are in pixels of the given size, as OpenCV gives
them: the centre of the top left pixel is (0, 0), and `distortion` is k1, k2, p1, p2, k3. Without `cx` and `cy` the
principal point is the middle of the image, without `fx` pixels are square, without `fy` all are those of the camera's
data sheet. Pictures of another shape are cut out of the middle. `pose_covariance`, 6 x 6, is kept with recordings.
Without a pose, the camera stays where the lab has it.

Boards whose place is known, against which a camera can be checked, are in `boards`, by name: the fields of
`rcs.calibration.Board`, and the pose of the board's middle in the scene, or in the base body of the gripper of the
robot that `on_gripper_of` names. Any other key is refused.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rcs_data.durable import write_file

from rcs.calibration import Board
from rcs.errors import InvalidSetup, UnknownName
from rcs.robots.calibration import CameraCalibration
from rcs.robots.description import Mount
from rcs.setups.lab import Lab
from rcs.spatial import Intrinsics

POSE = ("translation", "quaternion")
FOCAL = ("width", "height", "fx", "fy")
LENS = ("cx", "cy", "distortion")
COVARIANCE = "pose_covariance"
CARRIER = "on_gripper_of"


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """What a calibration says of one camera."""

    optical: Mount | None
    """Pose of the optical frame in the frame that carries the camera; None for where the lab has it."""
    camera: CameraCalibration
    """How it sees."""


@dataclass(frozen=True, kw_only=True)
class KnownBoard:
    """A board whose place is known."""

    board: Board
    """The board."""
    mount: Mount
    """Pose of its middle in what carries it."""
    on_gripper_of: str | None = None
    """Name of the robot whose gripper's base body carries it; None for the scene."""


def read_calibration(path: str | Path) -> dict[str, Calibration]:
    """Read the cameras of a calibration file.

    Args:
        path: The file.

    Raises:
        InvalidSetup: The file cannot be read, does not say what it must, or says what is not known here; the message
            names the camera and the field.
    """
    return _read(path)[0]


def read_boards(path: str | Path) -> dict[str, KnownBoard]:
    """Read the boards of a calibration file whose places are known.

    Args:
        path: The file.

    Raises:
        InvalidSetup: As `read_calibration`.
    """
    return _read(path)[1]


def _read(path: str | Path) -> tuple[dict[str, Calibration], dict[str, KnownBoard]]:
    try:
        data = Path(path).read_bytes()
        content = json.loads(data)
        if unknown := sorted(set(content) - {"cameras", "boards"}):
            raise ValueError(f"unknown key {unknown[0]!r}; valid are 'cameras' and 'boards'")
        sha256 = hashlib.sha256(data).hexdigest()
        cameras = {name: _calibration(name, about, sha256) for name, about in content["cameras"].items()}
        return cameras, {name: _board(name, about) for name, about in content.get("boards", {}).items()}
    except OSError as err:
        raise InvalidSetup(f"The calibration file {path} cannot be read: {err}.") from err
    except InvalidSetup as err:
        raise InvalidSetup(f"{path} is not a calibration file: {err}") from err
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as err:
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
        name: replace(mount, optical=found[name].optical or mount.optical, calibration=found[name].camera)
        if name in found
        else mount
        for name, mount in lab.cameras.items()
    }
    return replace(lab, cameras=cameras)


def write_calibration(
    path: str | Path, cameras: Mapping[str, Calibration], boards: Mapping[str, KnownBoard] | None = None
) -> None:
    """Write cameras and boards to a calibration file; those of other names that it has stay.

    Args:
        path: The file; made anew if there is none.
        cameras: Cameras by name.
        boards: Boards whose places are known, by name.

    Raises:
        InvalidSetup: There is a file, and it is not a calibration file.
        OSError: The file cannot be written.
    """
    path = Path(path)
    known, placed = _read(path) if path.exists() else ({}, {})
    content: dict[str, Any] = {
        "cameras": {name: _camera_as_json(one) for name, one in {**known, **cameras}.items()},
    }
    if every := {**placed, **(boards or {})}:
        content["boards"] = {name: _board_as_json(one) for name, one in every.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_file(path, (json.dumps(content, indent=2) + "\n").encode())


def _camera_as_json(calibration: Calibration) -> dict[str, Any]:
    about: dict[str, Any] = {} if calibration.optical is None else _mount_as_json(calibration.optical)
    seen = calibration.camera.intrinsics
    if seen is not None:
        about |= {"width": seen.width, "height": seen.height}
        about |= {"fx": seen.fx, "fy": seen.fy, "cx": seen.cx, "cy": seen.cy, "distortion": list(seen.distortion)}
    if calibration.camera.pose_covariance is not None:
        about[COVARIANCE] = [list(row) for row in calibration.camera.pose_covariance]
    return about


def _board_as_json(known: KnownBoard) -> dict[str, Any]:
    about = {**known.board.to_json(), **_mount_as_json(known.mount)}
    return about if known.on_gripper_of is None else {**about, CARRIER: known.on_gripper_of}


def _mount_as_json(mount: Mount) -> dict[str, Any]:
    return {"translation": list(mount.translation), "quaternion": list(mount.quaternion)}


def _calibration(name: str, about: dict[str, Any], sha256: str) -> Calibration:
    known = {*POSE, *FOCAL, *LENS, COVARIANCE}
    if unknown := sorted(set(about) - known):
        raise InvalidSetup(f"camera {name!r}: {UnknownName('key', unknown[0], known).message}")
    optical = _mount(f"camera {name!r}", about) if any(key in about for key in POSE) else None
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


def _board(name: str, about: dict[str, Any]) -> KnownBoard:
    on_gripper_of = about.get(CARRIER)
    if not isinstance(on_gripper_of, str | None):
        raise InvalidSetup(f"board {name!r}: {CARRIER} is {on_gripper_of!r}; valid is the name of a robot, or none.")
    try:
        board = Board.from_json({key: value for key, value in about.items() if key not in {*POSE, CARRIER}})
    except InvalidSetup as err:
        raise InvalidSetup(f"board {name!r}: {err}") from err
    return KnownBoard(board=board, mount=_mount(f"board {name!r}", about), on_gripper_of=on_gripper_of)


def _mount(what: str, about: dict[str, Any]) -> Mount:
    x, y, z = (float(value) for value in about["translation"])
    qx, qy, qz, qw = (float(value) for value in about["quaternion"])
    norm = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
    if not abs(norm - 1.0) < 1e-3:
        raise ValueError(f"{what}: quaternion has norm {norm:.4g}, a rotation needs 1")
    if not math.isfinite(x + y + z):
        raise ValueError(f"{what}: translation is {about['translation']}, valid are finite numbers [m]")
    return Mount(translation=(x, y, z), quaternion=(qx / norm, qy / norm, qz / norm, qw / norm))


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
