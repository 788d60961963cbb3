"""Where the least squares begin, found so that wrong detections and flipped boards do not matter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rcs.calibration.board import Board
from rcs.calibration.board_pose import BoardPose, board_poses
from rcs.calibration.closed_form import board_in_anchor, camera_in_mount, middle_pose, rigid
from rcs.calibration.fit import Guess, Sightings, tag_errors
from rcs.calibration.rig import Arrangement, View
from rcs.errors import InvalidSetup
from rcs.spatial import Intrinsics

TRIES = 120
"""Triples of views that are tried. With a third of them wrong or flipped, one in three triples is right."""
NEAR = 30.0
"""Error of a tag up to which it counts for a start, which is coarse [px]."""
TURNED = np.deg2rad(8.0)
"""Least angle between the views of a triple [rad]."""


def start(board: Board, views: Sequence[View], arrangement: Arrangement, intrinsics: Intrinsics) -> Guess:
    """Return the closed form of the triple of views that explains most of all tags (RANSAC, Fischler and Bolles 1981).

    Args:
        board: The board.
        views: The views.
        arrangement: What carries the camera.
        intrinsics: Of their pictures.

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
        if _least_turn(anchors[triple]) < TURNED:
            continue
        boards = np.array([_one(poses[i], rng).board_in_camera for i in triple])
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


def _one(found: list[BoardPose], rng: np.random.Generator) -> BoardPose:
    """Return the more likely pose, or sometimes the other."""
    return found[-1] if rng.random() < 0.2 else found[0]


def _least_turn(anchors: np.ndarray) -> float:
    pairs = [(0, 1), (0, 2), (1, 2)]
    cosines = [(np.trace(anchors[i, :3, :3].T @ anchors[j, :3, :3]) - 1) / 2 for i, j in pairs]
    return float(np.arccos(np.clip(max(cosines), -1.0, 1.0)))
