"""The lab of each robot: its usual end effector, the workspace on its table and where its cameras are mounted.

The paper does not print camera poses. These are ours: the wrist camera sees the fingertips, the side camera the whole
workspace.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from rcs.envs.task import Area
from rcs.errors import UnknownName
from rcs.robots.description import Mount
from rcs.spatial import Pose


@dataclass(frozen=True, kw_only=True)
class CameraMount:
    """A camera and where it is fixed."""

    camera: str
    """Name of the camera's description."""
    optical: Mount
    """Pose of the optical frame (x right, y down, z forward) in the parent's frame."""
    on_gripper: bool = False
    """Whether the parent is the gripper's base body; the robot's base frame otherwise."""


@dataclass(frozen=True, kw_only=True)
class Lab:
    """What usually stands around a robot."""

    end_effector: str
    """Name of the robot's usual gripper."""
    area: Area
    """Where tasks take place, in the robot's base frame."""
    cameras: dict[str, CameraMount] = field(default_factory=dict)
    """Camera mounts by name."""


def lab_of(robot: str) -> Lab:
    """Return the lab of a robot.

    Raises:
        UnknownName: The robot has none.
    """
    labs = _labs()
    if robot not in labs:
        raise UnknownName("robot", robot, labs)
    return labs[robot]


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


def _labs() -> dict[str, Lab]:
    return {
        "fr3": Lab(
            end_effector="franka_hand",
            area=Area(center=(0.5, 0.0), size=(0.30, 0.40)),
            cameras={
                # In front of the hand, its body clear of the fingers, tilted to see both pads and what is below them.
                "wrist": CameraMount(
                    camera="realsense_d405",
                    optical=looking((0.070, 0.0, 0.045), (0.0, 0.0, 0.17), up=(1.0, 0.0, 0.0)),
                    on_gripper=True,
                ),
                # Where a second robot would hold it: beside the workspace, looking across it.
                "side": CameraMount(camera="realsense_d435", optical=looking((0.66, 0.95, 0.50), (0.34, 0.0, 0.17))),
            },
        ),
    }
