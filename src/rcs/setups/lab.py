"""What a lab is: robots and where they stand, the workspace on their table, and where cameras are mounted."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from rcs.devices import lookup
from rcs.envs.task import Area
from rcs.errors import UnknownName
from rcs.robots.calibration import CameraCalibration
from rcs.robots.description import ArmDescription, Mount
from rcs.spatial import Pose


@dataclass(frozen=True, kw_only=True)
class Stand:
    """One robot of a lab."""

    name: str
    """Name in keys and prefixes."""
    arm: str
    """Name of the arm."""
    base_in_scene: Mount = Mount()
    """Pose of its base frame in the scene, whose origin is on the table top."""


@dataclass(frozen=True, kw_only=True)
class CameraMount:
    """A camera and where it is fixed."""

    camera: str
    """Name of the camera's description."""
    optical: Mount
    """Pose of the optical frame (x right, y down, z forward) in the parent's frame."""
    on_gripper_of: str | None = None
    """Name of the robot whose gripper's base body is the parent; None for the scene."""
    calibration: CameraCalibration | None = None
    """How it sees as calibrated; None for as in the data sheet."""


@dataclass(frozen=True, kw_only=True)
class Lab:
    """What usually stands around a robot."""

    stands: tuple[Stand, ...]
    """Its robots."""
    end_effector: str | None
    """Name of the usual end effector of every robot; None for a bare flange."""
    area: Area
    """Where tasks take place."""
    cameras: dict[str, CameraMount] = field(default_factory=dict[str, CameraMount])
    """Camera mounts by name."""


def lab_of(robot: str) -> Lab:
    """Return the lab of a name: an installed one, or a plain one around an arm that has none.

    Raises:
        UnknownName: There is neither a lab nor an arm of that name.
    """
    if robot in lookup.names("lab"):
        return lookup.find("lab", robot)
    if robot not in lookup.names("arm"):
        raise UnknownName("robot", robot, {*lookup.names("lab"), *lookup.names("arm")})
    return plain_lab(robot, lookup.find("arm", robot))


def plain_lab(name: str, arm: ArmDescription) -> Lab:
    """Return a lab for any arm: a workspace in the middle of its reach, and a camera that sees it from the side."""
    reach = arm.workspace_reach
    area = Area(center=(0.6 * reach, 0.0), size=(0.3 * reach, 0.4 * reach))
    side = CameraMount(
        camera="realsense_d435",
        optical=looking((0.8 * reach, 1.1 * reach, 0.6 * reach), (0.4 * reach, 0.0, 0.15 * reach)),
    )
    return Lab(
        stands=(Stand(name=name, arm=name),),
        end_effector=None,
        area=area,
        cameras={"side": side},
    )


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
