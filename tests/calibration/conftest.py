"""Views of a board as geometry alone would have them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from rcs.calibration import Arrangement, Board, Detections, View
from rcs.calibration.board_pose import project
from rcs.spatial import Intrinsics, Pose, distort

LENS = Intrinsics(width=640, height=480, fx=433.0, fy=431.0, cx=325.0, cy=236.0, distortion=(0.05, -0.02, 1e-3, 0, 0))
CAMERAS = {
    "eye-in-hand": Pose.from_rotvec([0.05, 0.01, 0.04], [0.1, 0.05, 1.5]),
    "eye-to-hand": Pose.from_rotvec([1.0, 0.5, 0.4], [-1.6, 0.3, 0.1]),
}
BOARDS = {
    "eye-in-hand": Pose.from_rotvec([0.5, 0.0, 0.0], [0.0, 0.0, 0.3]),
    "eye-to-hand": Pose.from_rotvec([0.0, 0.0, 0.2], [1.5, 0.0, 0.0]),
}


@dataclass(frozen=True, kw_only=True)
class Seen:
    """A camera, a board, and views of it."""

    board: Board
    arrangement: Arrangement
    camera: Pose
    place: Pose
    views: list[View]


def see(
    arrangement: Arrangement,
    *,
    views: int = 20,
    noise: float = 0.05,
    robot: tuple[float, float] = (0.0, 0.0),
    turns: tuple[float, float, float] = (0.35, 0.35, 0.7),
    lens: Intrinsics = LENS,
    seed: int = 0,
) -> Seen:
    """Return views with the board turned at random about its axes.

    Args:
        arrangement: Whether the camera is on the gripper or beside the robot.
        views: How many.
        noise: Standard deviation of corners [px].
        robot: Standard deviations of the flange's pose [m, rad].
        turns: Standard deviations of the board's rotation about x, y and z [rad].
        lens: How the camera sees.
        seed: Seed of the poses.
    """
    rng = np.random.default_rng(seed)
    board, camera, place = Board(), CAMERAS[arrangement], BOARDS[arrangement]
    facing = Pose.from_rotvec([0, 0, 0], [np.pi, 0, 0])
    found: list[View] = []
    while len(found) < views:
        turn = Pose.from_rotvec([0, 0, 0], rng.normal(0, 1, 3) * turns)
        middle = rng.uniform([-0.05, -0.05, 0.25], [0.05, 0.05, 0.5])
        board_in_camera = Pose(middle) * facing * turn
        rays = project(board_in_camera.matrix, board.corners)
        pixels = distort(rays, lens.distortion) * (lens.fx, lens.fy) + (lens.cx, lens.cy)
        if (pixels < 0).any() or (pixels > [lens.width - 1, lens.height - 1]).any():
            continue
        anchor_in_mount = camera * board_in_camera * place.inverse()
        flange = anchor_in_mount.inverse() if arrangement == "eye-in-hand" else anchor_in_mount
        off = Pose.from_rotvec(rng.normal(0, 1, 3) * robot[0], rng.normal(0, 1, 3) * robot[1])
        detections = Detections(np.array(board.ids), pixels + rng.normal(0, noise, pixels.shape))
        found.append(View(flange_in_base=flange * off, detections=detections))
    return Seen(board=board, arrangement=arrangement, camera=camera, place=place, views=found)


@pytest.fixture
def lens() -> Intrinsics:
    """How the camera of `seen` sees."""
    return LENS


@pytest.fixture
def seen() -> Callable[..., Seen]:
    """Makes views."""
    return see
