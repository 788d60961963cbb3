"""The rig that is calibrated: a camera on a gripper or beside the robot, and the board that it looks at.

Two poses are unknown. `camera_in_mount` is that of the optical frame (x right, y down, z forward) in its mount,
`board_in_anchor` that of the board in what carries it. With the camera on the gripper ("eye in hand") the mount is the
robot's flange and the anchor its base; with the camera beside the robot ("eye to hand") the mount is the base and the
anchor the flange.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from rcs.calibration.detection import Detections
from rcs.errors import InvalidSetup
from rcs.kinematics import Kinematics
from rcs.spatial import Intrinsics, Pose

Arrangement = Literal["eye-in-hand", "eye-to-hand"]
"""Whether the camera moves with the gripper, and the board does not, or the other way round."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Rig:
    """An arm and a camera that is to be calibrated."""

    kinematics: Kinematics
    """Kinematics of the arm's flange in its base frame."""
    arrangement: Arrangement
    """Place of the camera: on the gripper ("eye-in-hand") or beside the robot ("eye-to-hand")."""
    intrinsics: Intrinsics
    """How the camera sees, of pictures of the size that is looked at."""
    camera_in_mount: Pose
    """About where the camera is: some centimetres and degrees from it. Poses to drive to are found with it."""
    board_in_anchor: Pose | None = None
    """About where the board is; None if only a first view can show it."""

    def __post_init__(self) -> None:
        """Check the arrangement.

        Raises:
            InvalidSetup: There is no such arrangement.
        """
        if self.arrangement not in get_args(Arrangement):
            raise InvalidSetup(f"arrangement is {self.arrangement!r}; valid: {', '.join(get_args(Arrangement))}.")


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """The tags that were seen from one pose of the robot."""

    flange_in_base: Pose
    """Where the flange was."""
    detections: Detections
    """The tags that were seen."""

    def anchor_in_mount(self, arrangement: Arrangement) -> NDArray[np.float64]:
        """Return the pose of what carries the board in what carries the camera, (4, 4)."""
        pose = self.flange_in_base
        return (pose.inverse() if arrangement == "eye-in-hand" else pose).matrix
