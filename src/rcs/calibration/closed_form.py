"""Hand-eye calibration in closed form, as a start for the least squares that wrong detections do not disturb.

A X = X B for the rotations and then the translations, after Park and Martin, "Robot sensor calibration: solving
AX = XB on the Euclidean group", IEEE Transactions on Robotics and Automation 10 (5), 1994. The rotation that turns the
vectors of the one side best into those of the other is found by singular values (Kabsch).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from rcs.calibration.board import Board
from rcs.calibration.board_pose import angle, board_poses
from rcs.calibration.fit import Guess, Sightings, tag_errors
from rcs.calibration.rig import Arrangement, View
from rcs.errors import InvalidSetup
from rcs.spatial import Intrinsics, Pose

Poses = NDArray[np.float64]
"""Poses as matrices, (n, 4, 4)."""

TRIES = 120
"""Triples of views that are tried. With a third of them wrong or flipped, one in three triples is right."""
NEAR = 30.0
"""Error of a tag up to which it counts for a start, which is coarse [px]."""
TURNED = np.deg2rad(8.0)
"""Least angle between the views of a triple [rad]."""


def camera_in_mount(anchors_in_mount: Poses, boards_in_camera: Poses) -> NDArray[np.float64]:
    """Return the pose of a camera in its mount, (4, 4), from two or more views.

    Args:
        anchors_in_mount: Poses of the board's anchor in the camera's mount.
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
    """Return the pose of the board in its anchor according to each view, (n, 4, 4).

    Args:
        camera: Pose of the camera in its mount, (4, 4).
        anchors_in_mount: Poses of the board's anchor in the camera's mount.
        boards_in_camera: Poses of the board in the optical frame.
    """
    return np.linalg.inv(anchors_in_mount) @ camera @ boards_in_camera


def middle_pose(poses: Poses) -> NDArray[np.float64]:
    """Return the middle of some poses, (4, 4): medians of translations, and the mean of rotations.

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
    """Return a matrix as a pose, with rounding errors of its rotation removed.

    Args:
        matrix: The pose, (4, 4).
    """
    u, _, vt = np.linalg.svd(matrix[:3, :3])
    clean = np.eye(4)
    clean[:3, :3], clean[:3, 3] = u @ vt, matrix[:3, 3]
    return Pose.from_matrix(clean)


def start(board: Board, views: Sequence[View], arrangement: Arrangement, intrinsics: Intrinsics) -> Guess:
    """Return the closed form of the triple of views that explains most of all tags (RANSAC, Fischler and Bolles 1981).

    Args:
        board: The board.
        views: The views.
        arrangement: Whether the camera is on the gripper or beside the robot.
        intrinsics: Intrinsics of their images.

    Raises:
        InvalidSetup: No triple explains more than half of the tags.
    """
    seen = Sightings.of(board, views, arrangement, intrinsics)
    poses = [board_poses(board, view.detections, intrinsics) for view in views]
    usable = [i for i, found in enumerate(poses) if found]
    anchors = np.array([view.anchor_in_mount(arrangement) for view in views])
    rng = np.random.default_rng(0)
    best: tuple[float, Guess] | None = None
    for _ in range(TRIES if len(usable) >= 3 else 0):
        triple = rng.choice(usable, 3, replace=False)
        if min(angle(a, b) for a, b in combinations(anchors[triple], 2)) < TURNED:
            continue
        # The more likely pose in each view, or sometimes the other.
        boards = np.array([poses[i][-1 if rng.random() < 0.2 else 0].board_in_camera for i in triple])
        camera = camera_in_mount(anchors[triple], boards)
        guess = Guess(rigid(camera), rigid(middle_pose(board_in_anchor(camera, anchors[triple], boards))))
        cost = float(np.minimum(tag_errors(guess, seen), NEAR).mean())
        if best is None or cost < best[0]:
            best = cost, guess
    if best is None or best[0] > NEAR / 2:
        raise InvalidSetup(
            "No pose of the camera explains what most of these views show. The usual reasons: the board is not the one "
            "that is given (count its tags, measure one), it moved, the intrinsics are of another camera, the joints "
            "were not read when the picture was taken, or the camera is not where the arrangement says "
            f"({arrangement})."
        )
    return best[1]
