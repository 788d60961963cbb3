"""LeRobot's units for the SO101: degrees, or -100 .. 100 over a joint's range; 0 .. 100 for the gripper.

LeRobot counts degrees from the middle of the range in its calibration, which is 0 rad here. Its normalised positions
need that range; by default the functions use this arm's limits, and a full turn for the wrist roll, which LeRobot does
not record (so101_follower: full_turn_motor). Signs are those of the published description.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs.errors import InvalidSetup
from rcs.robots.so101.description import SO101

RANGE_LOWER: Final = (*SO101.joint_lower[:-1], -np.pi)
RANGE_UPPER: Final = (*SO101.joint_upper[:-1], np.pi)


def joints_to_degrees(joints: ArrayLike) -> NDArray[np.float64]:
    """Convert joints [rad] to degrees, any shape."""
    return np.rad2deg(np.asarray(joints, np.float64))


def degrees_to_joints(degrees: ArrayLike) -> NDArray[np.float64]:
    """Convert degrees to joints [rad], any shape."""
    return np.deg2rad(np.asarray(degrees, np.float64))


def joints_to_normalised(
    joints: ArrayLike, lower: ArrayLike = RANGE_LOWER, upper: ArrayLike = RANGE_UPPER
) -> NDArray[np.float64]:
    """Convert joints to -100 .. 100, clipped to the range as in LeRobot.

    Args:
        joints: Joint positions [rad], shape (..., 5).
        lower: Lower ends of the calibrated ranges [rad], shape (5,).
        upper: Upper ends [rad], shape (5,).

    Raises:
        InvalidSetup: A range is empty.
    """
    low, span = _range(lower, upper)
    return np.clip((np.asarray(joints, np.float64) - low) / span, 0.0, 1.0) * 200.0 - 100.0


def normalised_to_joints(
    normalised: ArrayLike, lower: ArrayLike = RANGE_LOWER, upper: ArrayLike = RANGE_UPPER
) -> NDArray[np.float64]:
    """Convert -100 .. 100, clipped to that range, to joints.

    Args:
        normalised: Normalised positions, shape (..., 5).
        lower: Lower ends of the calibrated ranges [rad], shape (5,).
        upper: Upper ends [rad], shape (5,).

    Returns:
        Joint positions [rad], shape (..., 5). A full-turn range may lead beyond the limits of the wrist roll.

    Raises:
        InvalidSetup: A range is empty.
    """
    low, span = _range(lower, upper)
    return low + np.clip((np.asarray(normalised, np.float64) + 100.0) / 200.0, 0.0, 1.0) * span


def opening_to_percent(opening: ArrayLike) -> NDArray[np.float64]:
    """Convert an opening, 0 closed .. 1 open, to LeRobot's gripper position, 0 closed .. 100 open, any shape."""
    return np.clip(np.asarray(opening, np.float64), 0.0, 1.0) * 100.0


def percent_to_opening(percent: ArrayLike) -> NDArray[np.float64]:
    """Convert LeRobot's gripper position, 0 closed .. 100 open, to an opening, 0 closed .. 1 open, any shape."""
    return np.clip(np.asarray(percent, np.float64) / 100.0, 0.0, 1.0)


def _range(lower: ArrayLike, upper: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    low = np.asarray(lower, np.float64)
    span = np.asarray(upper, np.float64) - low
    if not np.all(span > 0.0):
        raise InvalidSetup(f"Each range needs an upper end above its lower one, got {lower} .. {upper}.")
    return low, span
