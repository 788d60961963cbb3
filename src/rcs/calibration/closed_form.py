"""Hand-eye calibration in closed form, as a start for the least squares.

A X = X B for the rotations and then the translations, after Park and Martin, "Robot sensor calibration: solving
AX = XB on the Euclidean group", IEEE Transactions on Robotics and Automation 10 (5), 1994. The rotation that turns the
vectors of the one side best into those of the other is found by singular values (Kabsch).
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from rcs.spatial import Pose

Poses = NDArray[np.float64]
"""Poses as matrices, (n, 4, 4)."""


def camera_in_mount(anchors_in_mount: Poses, boards_in_camera: Poses) -> NDArray[np.float64]:
    """Return the pose of a camera in its mount, (4, 4), from two or more views.

    Args:
        anchors_in_mount: Poses of what carries the board in what carries the camera.
        boards_in_camera: Poses of the board in the optical frame.
    """
    pairs = list(combinations(range(len(anchors_in_mount)), 2))
    i, j = (np.array([pair[side] for pair in pairs]) for side in (0, 1))
    a = anchors_in_mount[i] @ np.linalg.inv(anchors_in_mount[j])
    b = boards_in_camera[i] @ np.linalg.inv(boards_in_camera[j])
    turns_a, turns_b = rotation_vectors(a), rotation_vectors(b)
    u, _, vt = np.linalg.svd(turns_a.T @ turns_b)
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    left = (a[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (b[:, :3, 3] @ rotation.T - a[:, :3, 3]).reshape(-1)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, np.linalg.lstsq(left, right)[0]
    return pose


def board_in_anchor(camera: NDArray[np.float64], anchors_in_mount: Poses, boards_in_camera: Poses) -> Poses:
    """Return where every view says that the board is in what carries it, (n, 4, 4).

    Args:
        camera: Pose of the camera in its mount, (4, 4).
        anchors_in_mount: Poses of what carries the board in what carries the camera.
        boards_in_camera: Poses of the board in the optical frame.
    """
    return np.linalg.inv(anchors_in_mount) @ camera @ boards_in_camera


def middle_pose(poses: Poses) -> NDArray[np.float64]:
    """Return the pose in the middle of some, (4, 4): medians of translations, and the mean of rotations.

    Args:
        poses: The poses.
    """
    u, _, vt = np.linalg.svd(poses[:, :3, :3].mean(axis=0))
    pose = np.eye(4)
    pose[:3, :3] = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    pose[:3, 3] = np.median(poses[:, :3, 3], axis=0)
    return pose


def rotation_vectors(poses: Poses) -> NDArray[np.float64]:
    """Return the rotations of poses as axis times angle [rad], (n, 3).

    Args:
        poses: The poses.
    """
    return np.array([rigid(pose).rotvec for pose in poses]).reshape(-1, 3)


def rigid(matrix: NDArray[np.float64]) -> Pose:
    """Return a matrix as a pose; what rounding has made of its rotation is set right.

    Args:
        matrix: The pose, (4, 4).
    """
    u, _, vt = np.linalg.svd(matrix[:3, :3])
    clean = np.eye(4)
    clean[:3, :3], clean[:3, 3] = u @ vt, matrix[:3, 3]
    return Pose.from_matrix(clean)
