"""The pose of the robot from which the next view tells most."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rcs.calibration.board import Board
from rcs.calibration.board_pose import project
from rcs.calibration.fit import Guess, Sightings, jacobian
from rcs.calibration.rig import Rig
from rcs.spatial import Intrinsics, distort, inverse, tquat_to_matrix

IsFree = Callable[[NDArray[np.float64], NDArray[np.float64]], bool]
"""Whether the arm may go straight from joints to joints [rad]."""

SCALES = (0.1, 0.25, 0.5, 0.9)
"""Standard deviations of the joints' changes that are tried [rad]."""
DRAWN = 800
"""Joints drawn per scale."""
COMPARED = 48
"""Poses with the board in view that are compared."""
FROM_LIMITS = 0.08
"""Least distance from joint limits [rad]."""
BORDER = 0.04
"""Share of the picture's height that the board keeps from its border."""
STEEPEST = np.deg2rad(60.0)
"""Largest angle between the board's normal and the line of sight [rad]: tags are found, and well, up to it."""
SMALLEST = 20.0
"""Least edge of a tag [px]."""
NOISE = 0.3
"""Standard deviation of a corner with the errors of the robot [px]."""
UNSURE = (0.03, 0.1)
"""What is taken for known before the first view: standard deviations of a pose [m, rad]."""


def suggest(
    rig: Rig,
    board: Board,
    guess: Guess,
    seen: Sightings,
    joints: Sequence[NDArray[np.float64]],
    *,
    rng: np.random.Generator,
    is_free: IsFree | None = None,
) -> NDArray[np.float64] | None:
    """Return the joints to go to, or None if none of those drawn will do.

    Joints are drawn around those from which the board was seen, inside the limits and such that the whole board is in
    view, large enough and not too slanted. Of them the one is best with which the known determinant of the information
    about both poses grows most (D-optimal design; Fedorov, "Theory of Optimal Experiments", 1972).

    Args:
        rig: What is calibrated.
        board: The board.
        guess: Where camera and board are, as far as is known.
        seen: What was seen so far.
        joints: Where to look around [rad]; the last are the present ones.
        rng: Random numbers.
        is_free: Whether the arm may go there from the present joints; None for anywhere.
    """
    drawn = _draw(rig, joints, rng)
    flanges = rig.kinematics.forward_batch(drawn)
    anchors = tquat_to_matrix(inverse(flanges) if rig.arrangement == "eye-in-hand" else flanges)
    in_view = np.flatnonzero(is_in_view(guess.boards_in_camera(anchors), board, rig.intrinsics))
    chosen = rng.permutation(in_view)[:COMPARED]
    if not len(chosen):
        return None
    known = _information(guess, seen) if len(seen) else np.zeros((12, 12))
    known += np.diag(np.tile([UNSURE[0] ** -2.0] * 3 + [UNSURE[1] ** -2.0] * 3, 2))
    gains = [_log_determinant(known + one) for one in _informations(guess, board, anchors[chosen], rig)]
    for i in np.argsort(gains)[::-1]:
        if is_free is None or is_free(joints[-1], drawn[chosen[i]]):
            return drawn[chosen[i]]
    return None


def is_in_view(boards_in_camera: NDArray[np.float64], board: Board, intrinsics: Intrinsics) -> NDArray[np.bool_]:
    """Return from which poses a whole board is seen, large enough and not too slanted, (n,).

    Args:
        boards_in_camera: Poses of the board in the optical frame, (n, 4, 4).
        board: The board.
        intrinsics: Of the picture.
    """
    corners = board.corners.reshape(-1, 3)
    depths = boards_in_camera[:, 2, :3] @ corners.T + boards_in_camera[:, 2, 3:]
    is_before = depths.min(axis=-1) > 0.02
    rays = project(boards_in_camera, corners)
    # What a lens does far out of the picture is of no meaning, and may fold back into it.
    is_near = (np.abs(rays) < 4.0).all(axis=(-2, -1))
    pixels = distort(np.clip(rays, -4.0, 4.0), intrinsics.distortion) * (intrinsics.fx, intrinsics.fy)
    pixels = pixels + (intrinsics.cx, intrinsics.cy)
    border = BORDER * intrinsics.height
    high = np.array([intrinsics.width, intrinsics.height]) - 1 - border
    is_inside = ((pixels > border) & (pixels < high)).all(axis=(-2, -1))
    tags = pixels.reshape(len(pixels), -1, 4, 2)
    edges = np.linalg.norm(tags - np.roll(tags, 1, axis=-2), axis=-1).min(axis=(-2, -1))
    middle = boards_in_camera[:, :3, 3]
    sight = -middle / np.linalg.norm(middle, axis=-1, keepdims=True)
    facing = np.einsum("ni,ni->n", sight, boards_in_camera[:, :3, 2]) > np.cos(STEEPEST)
    return is_before & is_near & is_inside & (edges > SMALLEST) & facing


def _draw(rig: Rig, joints: Sequence[NDArray[np.float64]], rng: np.random.Generator) -> NDArray[np.float64]:
    low, high = rig.kinematics.joint_lower + FROM_LIMITS, rig.kinematics.joint_upper - FROM_LIMITS
    centres = np.array(joints)[rng.integers(len(joints), size=(len(SCALES), DRAWN))]
    spread = np.array(SCALES)[:, None, None] * rng.standard_normal((len(SCALES), DRAWN, len(low)))
    drawn = (centres + spread).reshape(-1, len(low))
    return np.ascontiguousarray(drawn[((drawn >= low) & (drawn <= high)).all(axis=-1)])


def _informations(guess: Guess, board: Board, anchors: NDArray[np.float64], rig: Rig) -> list[NDArray[np.float64]]:
    """Return what a view from every pose would tell, (12, 12) each."""
    count, tags = len(anchors), len(board.ids)
    expected = Sightings(
        np.repeat(np.arange(count), tags),
        np.tile(board.ids, count),
        np.repeat(anchors, tags, axis=0),
        np.tile(board.corners, (count, 1, 1)),
        np.zeros((count * tags, 4, 2)),
        (rig.intrinsics.fx, rig.intrinsics.fy),
        rig.arrangement,
    )
    slopes = jacobian(replace(guess, given=None), expected).reshape(count, -1, 12) / NOISE
    return [one.T @ one for one in slopes]


def _information(guess: Guess, seen: Sightings) -> NDArray[np.float64]:
    slopes = jacobian(replace(guess, given=None), seen) / NOISE
    return slopes.T @ slopes


def _log_determinant(matrix: NDArray[np.float64]) -> float:
    return float(np.linalg.slogdet(matrix)[1])
