"""The axes of headsets: x to the right, y up, z to the back, as in OpenXR, WebXR and OpenVR."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

TO_FRONT_LEFT_UP = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Rotates a headset's axes into those of an input device: x to the front, y to the left, z up."""
FARTHEST = 100.0
"""Distance beyond which a pose is no pose [m]."""
UNIT = 0.01
"""Largest deviation of a quaternion's length from 1."""


def from_headset(pose: ArrayLike) -> NDArray[np.float64]:
    """Return a pose of a headset in the axes of an input device; NaN if it is no pose, which the feed leaves out.

    The hand's own axes change likewise: x is where it points.

    Args:
        pose: Translation [m] and quaternion xyzw, (7,).
    """
    given = np.asarray(pose, np.float64)
    length = float(np.linalg.norm(given[3:]))
    if not np.isfinite(given).all() or np.abs(given[:3]).max() > FARTHEST or abs(length - 1.0) > UNIT:
        return np.full(7, np.nan)
    turned = given[3:] / length
    return np.array([*(TO_FRONT_LEFT_UP @ given[:3]), *(TO_FRONT_LEFT_UP @ turned[:3]), turned[3]])
