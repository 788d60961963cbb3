"""Where the cameras of a lab are and how they see, in a calibration file.

A file is JSON with the fields of `Calibration` by the name of the camera, and of `KnownBoard` by the name of the board:

    {"cameras": {"side": {"optical": {"translation": [0.66, 0.95, 0.50], "quaternion": [0.1, 0.2, 0.3, 0.927]},
                          "intrinsics": {"width": 640, "height": 480, "fx": 617.0, "fy": 616.2,
                                         "cx": 321.4, "cy": 238.9, "distortion": [0.11, -0.24, 0.001, 0.0, 0.0]}}},
     "boards": {"side": {"board": {"rows": 2, "columns": 2}, "mount": {"translation": [0.0, 0.0, 0.2]},
                         "on_gripper_of": "fr3"}}}

Poses are those of the optical frame (x right, y down, z forward; m, xyzw) in the frame that carries the camera: the
scene, or the gripper's base body for a camera on a gripper. Intrinsics are in pixels of the given size, as OpenCV gives
them; pictures of another shape are cut out of the middle. The board of a camera on a gripper lies in the scene, and has
no `on_gripper_of`. Without a pose, the camera stays where the lab has it; without intrinsics, it sees as in its data
sheet. Any other key is refused.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from rcs_data.files.durable import write_file
from rcs_data.options import Record

from rcs.calibration import Board
from rcs.errors import InvalidSetup
from rcs.robots.camera import Calibration
from rcs.robots.description import Mount
from rcs.setups.lab import Lab

Entry = TypeVar("Entry", bound=Record)


class KnownBoard(Record):
    """A board whose place is known, against which a camera can be checked."""

    board: Board = Board()
    """The board."""
    mount: Mount
    """Pose of its middle in what carries it."""
    on_gripper_of: str | None = None
    """Name of the robot whose gripper's base body carries it; None for the scene."""


@dataclass(frozen=True, kw_only=True)
class CalibrationFile:
    """The content of a calibration file."""

    cameras: Mapping[str, Calibration]
    """Cameras by name."""
    boards: Mapping[str, KnownBoard]
    """Boards by name."""


def read_calibration(path: str | Path) -> CalibrationFile:
    """Read a calibration file.

    Args:
        path: The file.

    Raises:
        InvalidSetup: The file cannot be read, does not say what it must, or says what is not known here; the message
            names the entry and the field.
    """
    try:
        data = Path(path).read_bytes()
        content = json.loads(data)
        if unknown := sorted(set(content) - {"cameras", "boards"}):
            raise ValueError(f"unknown key {unknown[0]!r}; valid are 'cameras' and 'boards'")
        sha256 = hashlib.sha256(data).hexdigest()
        cameras = {name: {**about, "sha256": sha256} for name, about in content["cameras"].items()}
        boards = content.get("boards", {})
        return CalibrationFile(cameras=_entries(Calibration, cameras), boards=_entries(KnownBoard, boards))
    except OSError as err:
        raise InvalidSetup(f"The calibration file {path} cannot be read: {err}.") from err
    except InvalidSetup as err:
        raise InvalidSetup(f"{path} is not a calibration file: {err}") from err
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as err:
        raise InvalidSetup(f"{path} is not a calibration file: {err!r}.") from err


def _entries(kind: type[Entry], values: Mapping[str, Any]) -> dict[str, Entry]:
    found: dict[str, Entry] = {}
    for name, about in values.items():
        try:
            found[name] = kind.from_json(about)
        except InvalidSetup as err:
            raise InvalidSetup(f"{name}: {err}") from err
    return found


def calibrated(lab: Lab, path: str | Path) -> Lab:
    """Return a lab whose cameras are where a calibration file says; cameras that it does not name stay as they are.

    Raises:
        InvalidSetup: The file is not valid, or names a camera that the lab does not have.
    """
    found = read_calibration(path).cameras
    if unknown := sorted(set(found) - set(lab.cameras)):
        raise InvalidSetup(f"{path} has the cameras {unknown}, which this lab has not; it has {sorted(lab.cameras)}.")
    cameras = {
        name: replace(lab.cameras[name], optical=one.optical or lab.cameras[name].optical, calibration=one)
        for name, one in found.items()
    }
    return replace(lab, cameras={**lab.cameras, **cameras})


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
    known = read_calibration(path) if path.exists() else CalibrationFile(cameras={}, boards={})
    every = {"cameras": {**known.cameras, **cameras}, "boards": {**known.boards, **(boards or {})}}
    content = {kind: {name: _as_json(one) for name, one in own.items()} for kind, own in every.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_file(path, (json.dumps(content, indent=2) + "\n").encode())


def _as_json(entry: Record) -> dict[str, Any]:
    return {key: value for key, value in entry.to_json().items() if value is not None and key != "sha256"}
