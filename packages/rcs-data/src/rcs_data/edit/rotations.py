"""Rotations as unit quaternions xyzw, for actions that turn a tool."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Quaternion = NDArray[np.float64]

IDENTITY: Quaternion = np.array([0.0, 0.0, 0.0, 1.0])


def multiply(second: Quaternion, first: Quaternion) -> Quaternion:
    """Return the quaternion, shape (4,), of one rotation after another."""
    a, b = second[:3], first[:3]
    vector = second[3] * b + first[3] * a + np.cross(a, b)
    return np.append(vector, second[3] * first[3] - a @ b)


def normalized(quaternion: Quaternion) -> Quaternion:
    """Return a quaternion, shape (4,), scaled to norm 1."""
    return quaternion / np.linalg.norm(quaternion)


def from_rotvec(rotvec: NDArray[np.float64]) -> Quaternion:
    """Return the quaternion of a rotation vector, axis times angle [rad], shape (3,)."""
    half = float(np.linalg.norm(rotvec)) / 2
    return np.append(rotvec / 2 * np.sinc(half / math.pi), math.cos(half))


def to_rotvec(quaternion: Quaternion) -> NDArray[np.float64]:
    """Return the rotation vector [rad], shape (3,), of at most half a turn."""
    upper = quaternion if quaternion[3] >= 0 else -quaternion
    sine = float(np.linalg.norm(upper[:3]))
    if sine < 1e-12:
        return 2 * upper[:3]
    return upper[:3] * (2 * math.atan2(sine, float(upper[3])) / sine)


def from_rpy(rpy: NDArray[np.float64]) -> Quaternion:
    """Return the quaternion of roll, pitch, yaw [rad], shape (3,), about the fixed axes x, y, z in this order."""
    about_x, about_y, about_z = (from_rotvec(angle * axis) for angle, axis in zip(rpy, np.eye(3), strict=True))
    return multiply(about_z, multiply(about_y, about_x))


def to_rpy(quaternion: Quaternion) -> NDArray[np.float64]:
    """Return roll, pitch, yaw [rad], shape (3,); yaw is 0 where the pitch is a quarter turn."""
    x, y, z, w = quaternion
    sine = float(np.clip(2 * (w * y - z * x), -1.0, 1.0))
    if abs(sine) > 1 - 1e-12:
        return np.array([2 * math.atan2(x, w), math.copysign(math.pi / 2, sine), 0.0])
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.array([roll, math.asin(sine), yaw])
