"""Whether the poses of a set of views determine where the camera is, and which motions are missing.

Two rotations about different axes are the least (Tsai and Lenz, "A new technique for fully autonomous and efficient 3D
robotics hand/eye calibration", 1989). Far from the least, errors shrink with the size of the rotations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rcs.calibration.closed_form import middle_pose
from rcs.errors import InvalidSetup
from rcs.spatial import Pose

FEWEST = 8
"""Fewest views."""
LARGEST_TURN = np.deg2rad(20.0)
"""Least angle between the two views that differ most [rad]."""
SPREAD = np.deg2rad(5.0)
"""Least standard deviation of the rotations about a second axis [rad]."""


@dataclass(frozen=True, eq=False)
class Motions:
    """How the flange turns in a set of views."""

    count: int
    """Number of views."""
    largest_turn: float
    """Angle between the two views that differ most [rad]."""
    spread: NDArray[np.float64]
    """Standard deviations of the rotations about three axes, the most used first [rad], (3,)."""
    axes: NDArray[np.float64]
    """These axes in the flange's frame in the middle of all views, (3, 3), one per row."""

    @property
    def lacks(self) -> list[str]:
        """Missing motions, in words; nothing if the set will do."""
        missing: list[str] = []
        if self.count < FEWEST:
            missing.append(f"{self.count} views are too few: add {FEWEST - self.count}")
        most = np.rad2deg(self.largest_turn)
        if self.largest_turn < np.deg2rad(2.0):
            missing.append(
                "the flange only moves and never turns, so the camera may be anywhere: add poses that are turned by 20 "
                "to 40 degrees about its x axis and about its y axis"
            )
        elif self.spread[1] < SPREAD:
            missing.append(
                f"it turns about one axis only, {_axis(self.axes[0])} of the flange, along which the camera may be "
                f"anywhere: add poses that are turned by 20 to 40 degrees about {_axis(self.axes[1])} and about "
                f"{_axis(self.axes[2])}"
            )
        elif self.largest_turn < LARGEST_TURN:
            missing.append(
                f"the largest turn between two views is {most:.0f} degrees, too small: add poses that are turned by 20 "
                f"to 40 degrees to both sides about {_axis(self.axes[0])} and about {_axis(self.axes[1])} of the flange"
            )
        return missing

    def require_enough(self) -> None:
        """Refuse a set that does not determine where the camera is.

        Raises:
            InvalidSetup: Motions are missing; the message says which.
        """
        if self.lacks:
            raise InvalidSetup(f"These views cannot tell where the camera is: {'; '.join(self.lacks)}.")


def motions(flanges_in_base: Sequence[Pose]) -> Motions:
    """Return how a flange turns.

    Args:
        flanges_in_base: Its poses in the base frame, one per view.
    """
    if not flanges_in_base:
        return Motions(0, 0.0, np.zeros(3), np.eye(3))
    poses = np.array([pose.matrix for pose in flanges_in_base])
    middle = Pose.from_matrix(middle_pose(poses))
    turns = np.array([(middle.inverse() * pose).rotvec for pose in flanges_in_base])
    rotations = poses[:, :3, :3]
    cosines = (np.einsum("aij,bij->ab", rotations, rotations) - 1) / 2
    _, values, axes = np.linalg.svd(turns - turns.mean(axis=0))
    spread = np.zeros(3)
    spread[: len(values)] = values / np.sqrt(len(turns))
    return Motions(len(poses), float(np.arccos(np.clip(cosines.min(), -1, 1))), spread, axes)


def _axis(axis: NDArray[np.float64]) -> str:
    """Return an axis in words: the frame's own where it is near one."""
    nearest = int(np.argmax(np.abs(axis)))
    if abs(axis[nearest]) > np.cos(np.deg2rad(15.0)):
        return f"the {'xyz'[nearest]} axis"
    x, y, z = axis * np.sign(axis[nearest])
    return f"the axis ({x:.1f}, {y:.1f}, {z:.1f})"
