"""How a camera sees, from pictures of a board: focal lengths, principal point, distortion (Zhang 2000, by OpenCV)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rcs.calibration.board import Board
from rcs.calibration.board_pose import board_poses, limit_of, project, rms
from rcs.calibration.detection import Detections
from rcs.errors import InvalidSetup
from rcs.extras import package_of
from rcs.spatial import Intrinsics

FEWEST = 8
"""Fewest pictures."""
FEWEST_TAGS = 3
"""Fewest tags of a picture that counts, or all of a board that has fewer: one tag is too small to tell of the lens."""
TILTED = np.deg2rad(15.0)
"""Angle between the board and the picture from which it counts as tilted [rad]."""
GRID = (4, 4)
"""Columns and rows into which a picture is divided to see where corners were."""
LEAST_COVERED = 0.6
"""Least share of the grid's fields that corners were in."""
FOLDS = 5
"""Parts of the pictures, each of which is left out once."""


@dataclass(frozen=True, kw_only=True, eq=False)
class IntrinsicsFit:
    """How a camera sees, and how well that is known."""

    intrinsics: Intrinsics
    """Intrinsics that were found."""
    sigma: tuple[float, float, float, float]
    """Standard deviations of fx, fy, cx, cy [px], if errors of corners were independent; they are a little larger."""
    residual_px: float
    """Root of the mean squared distance between a corner seen and expected [px]."""
    held_out_px: float
    """The same in pictures that were left out [px], with the pose of the board fitted to them."""
    pictures: int
    """Pictures that were used."""
    rejected: int
    """Tags that were left out because they are not where the others say."""

    def __str__(self) -> str:
        """Return the result in words."""
        k, sigma = self.intrinsics, self.sigma
        return "\n".join(
            [
                f"fx {k.fx:.2f} +- {sigma[0]:.2f}, fy {k.fy:.2f} +- {sigma[1]:.2f}, cx {k.cx:.2f} +- {sigma[2]:.2f}, "
                f"cy {k.cy:.2f} +- {sigma[3]:.2f} px of {k.width} x {k.height}",
                f"distortion {', '.join(f'{value:.4f}' for value in k.distortion)}",
                f"left-out pictures: {self.held_out_px:.2f} px; residual {self.residual_px:.2f} px; "
                f"{self.pictures} pictures, {self.rejected} tags rejected",
            ]
        )


def fit_intrinsics(board: Board, pictures: Sequence[Detections], size: tuple[int, int]) -> IntrinsicsFit:
    """Find how a camera sees.

    The fit finds k1, k2, p1 and p2 of the distortion; k3 stays 0, because only corners at the very border show it.

    Args:
        board: The board.
        pictures: Its tags in pictures from different sides.
        size: Width and height of all pictures [px].

    Raises:
        InvalidSetup: The pictures do not suffice; the message says which are missing.
    """
    least = min(FEWEST_TAGS, len(board.ids))
    usable = [found for found in pictures if len(found) >= least]
    lacks = _lacks(board, usable, size)
    if lacks:
        raise InvalidSetup(f"These pictures cannot tell how the camera sees: {'; '.join(lacks)}.")
    rough = _calibrated(board, usable, size)
    errors = [_errors(board, found, rough[0]) for found in usable]
    limit = limit_of(np.concatenate(errors))
    right = [found[error < limit] for found, error in zip(usable, errors, strict=True)]
    kept = [found for found in right if len(found) >= least]
    if lacks := _lacks(board, kept, size):
        raise InvalidSetup(f"Without the tags that are not where the others say, {'; '.join(lacks)}.")
    intrinsics, sigma = _calibrated(board, kept, size)
    held_out: list[NDArray[np.float64]] = []
    for fold in range(FOLDS):
        others = [found for i, found in enumerate(kept) if i % FOLDS != fold]
        without = _calibrated(board, others, size)[0]
        held_out += [_errors(board, found, without) for found in kept[fold::FOLDS]]
    return IntrinsicsFit(
        intrinsics=intrinsics,
        sigma=sigma,
        residual_px=rms(np.concatenate([_errors(board, found, intrinsics) for found in kept])),
        held_out_px=rms(np.concatenate(held_out)),
        pictures=len(kept),
        rejected=sum(len(found) for found in usable) - sum(len(found) for found in kept),
    )


def _calibrated(
    board: Board, pictures: Sequence[Detections], size: tuple[int, int]
) -> tuple[Intrinsics, tuple[float, float, float, float]]:
    cv2 = package_of("calibration", "cv2")
    points = [board.corners_of(found.ids).reshape(-1, 1, 3).astype(np.float32) for found in pictures]
    seen = [found.corners.reshape(-1, 1, 2).astype(np.float32) for found in pictures]
    _, matrix, distortion, _, _, sigma, _, _ = cv2.calibrateCameraExtended(
        points, seen, size, None, None, flags=cv2.CALIB_FIX_K3
    )
    fx, fy, cx, cy = (float(value) for value in np.ravel(sigma)[:4])
    return Intrinsics.of_matrix(matrix, size, np.ravel(distortion)[:5]), (fx, fy, cx, cy)


def _errors(board: Board, found: Detections, intrinsics: Intrinsics) -> NDArray[np.float64]:
    """Return the error of each tag with the pose that fits best [px], (n,)."""
    pose = board_poses(board, found, intrinsics)[0]
    off = project(pose.board_in_camera, board.corners_of(found.ids)) - found.rays(intrinsics)
    return np.sqrt(((off * (intrinsics.fx, intrinsics.fy)) ** 2).sum(axis=-1).mean(axis=-1))


def _lacks(board: Board, pictures: Sequence[Detections], size: tuple[int, int]) -> list[str]:
    """Return what is missing, in words."""
    least = min(FEWEST_TAGS, len(board.ids))
    if len(pictures) < FEWEST:
        return [f"{len(pictures)} pictures with at least {least} tags are too few: add {FEWEST - len(pictures)}"]
    lacks: list[str] = []
    tilts = np.array([_tilt(board, found, size) for found in pictures])
    if (np.abs(tilts).max(axis=0) < TILTED).any():
        axis = ("horizontal", "vertical")[int(np.argmin(np.abs(tilts).max(axis=0)))]
        lacks.append(
            f"the board is never tilted about a {axis} axis, so focal length and distance cannot be told apart: add "
            "pictures with the board tilted by 20 to 45 degrees, to both sides"
        )
    corners = np.concatenate([found.corners.reshape(-1, 2) for found in pictures])
    fields = np.clip((corners / size * GRID).astype(int), 0, np.array(GRID) - 1)
    hit = np.zeros(GRID, bool)
    hit[fields[:, 0], fields[:, 1]] = True
    if hit.mean() < LEAST_COVERED:
        halves = {"left": hit[:2], "right": hit[2:], "upper": hit[:, :2], "lower": hit[:, 2:]}
        emptiest = min(halves, key=lambda name: float(halves[name].mean()))
        lacks.append(
            f"corners were in {hit.mean():.0%} of the picture's parts: add pictures with the board elsewhere, first in "
            f"the {emptiest} half, and near the borders"
        )
    return lacks


def _tilt(board: Board, found: Detections, size: tuple[int, int]) -> NDArray[np.float64]:
    """Return about how far a board is tilted about the picture's axes [rad], (2,), as a usual lens would have it."""
    focal = float(max(size))
    usual = Intrinsics(width=size[0], height=size[1], fx=focal, fy=focal, cx=(size[0] - 1) / 2, cy=(size[1] - 1) / 2)
    poses = board_poses(board, found, usual)
    normal = poses[0].board_in_camera[:3, 2]
    return np.array([np.arctan2(normal[1], -normal[2]), np.arctan2(normal[0], -normal[2])])
