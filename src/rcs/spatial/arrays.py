"""Functions on arrays of poses: one pose or a batch, indexed from the right, as float64.

A pose is a `tquat`, shape (..., 7): translation [m] and unit quaternion xyzw; or an `xyzrpy`, shape (..., 6):
translation [m] and roll, pitch, yaw [rad] about the fixed x, y, z axes, in that order. Leading dimensions are kept;
each of several arguments has the same leading shape or is a single pose for every row. Results are new arrays; the
quaternions of poses have w >= 0. Poses with numbers that are not finite, or with a quaternion more than 1e-3 off norm
1, raise a ValueError that names the row; `normalize` accepts quaternions of any length.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from rcs import _core

FloatArray: TypeAlias = npt.NDArray[np.float64]


def compose(a: npt.ArrayLike, b: npt.ArrayLike) -> FloatArray:
    """Chain poses: those of C in A from those of B in A and C in B.

    Args:
        a: Poses of B in A as tquat, shape (..., 7).
        b: Poses of C in B as tquat, shape (..., 7).
    """
    return _core.compose_tquat(a, b)


def inverse(a: npt.ArrayLike) -> FloatArray:
    """Invert poses: those of A in B from those of B in A.

    Args:
        a: Poses of B in A as tquat, shape (..., 7).
    """
    return _core.inverse_tquat(a)


def relative(a: npt.ArrayLike, b: npt.ArrayLike) -> FloatArray:
    """Express poses in the frames of others: inverse(a) composed with b.

    Args:
        a: Poses of the new frames of reference as tquat, shape (..., 7).
        b: Poses given in the same frame as `a`, as tquat, shape (..., 7).
    """
    return _core.relative_tquat(a, b)


def interpolate(a: npt.ArrayLike, b: npt.ArrayLike, fraction: npt.ArrayLike) -> FloatArray:
    """Interpolate between poses: straight line and shortest rotation, both at constant speed.

    Args:
        a: Poses at fraction 0 as tquat, shape (..., 7).
        b: Poses at fraction 1 as tquat, shape (..., 7).
        fraction: Fractions in [0, 1], shape (...). Several fractions between two single poses make a path.

    Raises:
        ValueError: A fraction is outside [0, 1].
    """
    return _core.interpolate_tquat(a, b, fraction)


def limit_step(start: npt.ArrayLike, goal: npt.ArrayLike, max_translation: float, max_rotation: float) -> FloatArray:
    """Move from start towards goal within limits on translation and on rotation.

    Args:
        start: Poses to start from as tquat, shape (..., 7).
        goal: Poses to reach as tquat, shape (..., 7); returned unchanged if within both limits.
        max_translation: Longest distance from start [m], at least 0; infinity for no limit.
        max_rotation: Largest angle from start [rad], at least 0; infinity for no limit.

    Raises:
        ValueError: A limit is below 0 or NaN.
    """
    return _core.limit_step_tquat(start, goal, max_translation, max_rotation)


def distance(a: npt.ArrayLike, b: npt.ArrayLike) -> FloatArray:
    """Measure how far poses are apart: distance of the origins [m] and angle of the rotation [rad], shape (..., 2).

    Args:
        a: Poses as tquat, shape (..., 7).
        b: Poses as tquat, shape (..., 7).
    """
    return _core.distance_tquat(a, b)


def normalize(tquat: npt.ArrayLike) -> FloatArray:
    """Normalize quaternions of any length to norm 1 and w >= 0, for numbers from a policy or file.

    Args:
        tquat: Translations [m] and quaternions xyzw of any length but 0, shape (..., 7).

    Raises:
        ValueError: All components of a quaternion are below 1e-9, so it has no direction.
    """
    return _core.normalize_tquat(tquat)


def tquat_to_xyzrpy(tquat: npt.ArrayLike) -> FloatArray:
    """Convert quaternions to roll, pitch, yaw: roll and yaw in (-pi, pi], pitch in [-pi/2, pi/2].

    Args:
        tquat: Poses, shape (..., 7). Where pitch is ±pi/2, roll is chosen as 0.
    """
    return _core.tquat_to_xyzrpy(tquat)


def xyzrpy_to_tquat(xyzrpy: npt.ArrayLike) -> FloatArray:
    """Convert roll, pitch, yaw to quaternions.

    Args:
        xyzrpy: Poses, shape (..., 6), with angles of any size.
    """
    return _core.xyzrpy_to_tquat(xyzrpy)


def tquat_to_matrix(tquat: npt.ArrayLike) -> FloatArray:
    """Convert poses to homogeneous matrices, shape (..., 4, 4).

    Args:
        tquat: Poses, shape (..., 7).
    """
    return _core.tquat_to_matrix(tquat)


def matrix_to_tquat(matrix: npt.ArrayLike) -> FloatArray:
    """Convert homogeneous matrices to poses, shape (..., 7).

    Args:
        matrix: Rotations and translations [m] above the row (0, 0, 0, 1), shape (..., 4, 4).

    Raises:
        ValueError: A matrix is more than 1e-6 off a rotation.
    """
    return _core.matrix_to_tquat(matrix)


def wxyz_to_xyzw(wxyz: npt.ArrayLike) -> FloatArray:
    """Reorder quaternions of MuJoCo; the numbers stay as they are.

    Args:
        wxyz: Quaternions with the scalar first, shape (..., 4).
    """
    return _core.wxyz_to_xyzw(wxyz)


def xyzw_to_wxyz(xyzw: npt.ArrayLike) -> FloatArray:
    """Reorder quaternions for MuJoCo; the numbers stay as they are.

    Args:
        xyzw: Quaternions with the scalar last, shape (..., 4).
    """
    return _core.xyzw_to_wxyz(xyzw)
