"""Poses and conversions between their representations; the only place that knows about quaternion order."""

from __future__ import annotations

from rcs._core import Pose
from rcs.spatial.arrays import (
    FloatArray,
    compose,
    distance,
    interpolate,
    inverse,
    limit_step,
    matrix_to_tquat,
    normalize,
    relative,
    tquat_to_matrix,
    tquat_to_xyzrpy,
    wxyz_to_xyzw,
    xyzrpy_to_tquat,
    xyzw_to_wxyz,
)

__all__ = [
    "FloatArray",
    "Pose",
    "compose",
    "distance",
    "interpolate",
    "inverse",
    "limit_step",
    "matrix_to_tquat",
    "normalize",
    "relative",
    "tquat_to_matrix",
    "tquat_to_xyzrpy",
    "wxyz_to_xyzw",
    "xyzrpy_to_tquat",
    "xyzw_to_wxyz",
]
