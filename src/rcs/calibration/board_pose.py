"""The pose of a board in one picture, and the second one that a flat board may have.

A flat target that is small or far away looks nearly the same when it is tilted the other way: IPPE (Collins and
Bartoli, "Infinitesimal Plane-based Pose Estimation", IJCV 2014) gives both poses. Each tag proposes its own two
besides, so that a tag that was found in a wrong place does not spoil the board's.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs.calibration.board import Board
from rcs.calibration.detection import Detections
from rcs.extras import package_of
from rcs.spatial import Intrinsics

FAR = 3.0
"""Error of a tag beyond which it does not count for a pose [px]."""
WRONG = (1.0, 4.0)
"""A tag is wrong if its error is larger than this [px], and than this times the median of all."""
FLIPPED = np.deg2rad(5.0)
"""Angle between two poses from which they are two [rad]."""


@dataclass(frozen=True, eq=False)
class BoardPose:
    """A pose that a board may have."""

    board_in_camera: NDArray[np.float64]
    """The pose in the optical frame, (4, 4)."""
    error: float
    """Root of the mean squared distance between corners seen and expected, of the tags that fit [px]."""
    fits: NDArray[np.bool_]
    """Which tags fit, (n,)."""


def board_poses(board: Board, detections: Detections, intrinsics: Intrinsics) -> list[BoardPose]:
    """Return the one or two poses that a board may have, the more likely one first; none if nothing was seen.

    Args:
        board: The board.
        detections: Its tags in a picture.
        intrinsics: Intrinsics of the picture.
    """
    if not len(detections):
        return []
    points, rays = board.corners_of(detections.ids), detections.rays(intrinsics)
    focal = (intrinsics.fx + intrinsics.fy) / 2
    parts = [slice(None), *([i] for i in range(len(rays)) if len(rays) > 1)]
    proposed = list(chain.from_iterable(_ippe(points[part], rays[part]) for part in parts))
    found: list[BoardPose] = []
    for pose in sorted((_judged(pose, points, rays, focal) for pose in proposed), key=_cost):
        fits = pose.fits if pose.fits.any() else np.ones(len(rays), bool)
        better = _judged(_refined(pose.board_in_camera, points[fits], rays[fits]), points, rays, focal)
        best = min(better, pose, key=_cost)
        if all(angle(best.board_in_camera, other.board_in_camera) > FLIPPED for other in found):
            found.append(best)
    return sorted(found, key=_cost)[:2]


def project(board_in_camera: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where points of a board are seen, x / z and y / z in the optical frame.

    Args:
        board_in_camera: Poses, (..., 4, 4).
        points: Points in the board's frame [m], (..., n, 3).
    """
    seen = points @ np.swapaxes(board_in_camera[..., :3, :3], -1, -2) + board_in_camera[..., None, :3, 3]
    return seen[..., :2] / np.where(np.abs(seen[..., 2:]) < 1e-6, 1e-6, seen[..., 2:])


def angle(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Return the angle between two poses, (4, 4) each [rad]."""
    return float(np.arccos(np.clip((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2, -1.0, 1.0)))


def limit_of(errors: NDArray[np.float64]) -> float:
    """Return the error from which a tag is wrong [px], for the errors of all tags [px]."""
    return max(WRONG[0], WRONG[1] * float(np.median(errors)))


def rms(values: ArrayLike) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def _errors(pose: NDArray[np.float64], points: Any, rays: Any, focal: float) -> NDArray[np.float64]:
    """Return the error of each tag [px]; infinity behind the camera."""
    off = focal * (project(pose, points) - rays)
    behind = (points @ pose[2, :3] + pose[2, 3]).min(axis=-1) <= 0
    return np.where(behind, np.inf, np.sqrt((off**2).sum(axis=-1).mean(axis=-1)))


def _judged(pose: NDArray[np.float64], points: Any, rays: Any, focal: float) -> BoardPose:
    errors = _errors(pose, points, rays, focal)
    fits = errors < FAR
    return BoardPose(pose, rms(errors[fits]) if fits.any() else float("inf"), fits)


def _cost(pose: BoardPose) -> tuple[int, float]:
    return -int(pose.fits.sum()), pose.error


def _ippe(points: NDArray[np.float64], rays: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    cv2 = package_of("calibration", "cv2")
    flat, seen = points.reshape(-1, 3), rays.reshape(-1, 2)
    middle = flat.mean(axis=0)  # IPPE wants points about the origin
    found, rotations, translations, _ = cv2.solvePnPGeneric(
        flat - middle, seen, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
    )
    poses: list[NDArray[np.float64]] = []
    for rotation, translation in zip(rotations, translations, strict=True) if found else ():
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(rotation)[0]
        pose[:3, 3] = translation[:, 0] - pose[:3, :3] @ middle
        if np.isfinite(pose).all():
            poses.append(pose)
    return poses


def _refined(pose: NDArray[np.float64], points: NDArray[np.float64], rays: NDArray[np.float64]) -> NDArray[np.float64]:
    cv2 = package_of("calibration", "cv2")
    rotation, translation = cv2.solvePnPRefineLM(
        points.reshape(-1, 3), rays.reshape(-1, 2), np.eye(3), None, cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3:].copy()
    )
    refined = np.eye(4)
    refined[:3, :3], refined[:3, 3] = cv2.Rodrigues(rotation)[0], translation[:, 0]
    return refined if np.isfinite(refined).all() else pose
