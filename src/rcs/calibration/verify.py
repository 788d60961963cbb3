"""How far boards are seen from where a calibration expects them, in views that it was not made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rcs.calibration.board import Board
from rcs.calibration.board_pose import board_poses
from rcs.calibration.closed_form import rigid
from rcs.calibration.fit import Guess, Sightings, moved_by, tag_errors
from rcs.calibration.rig import Arrangement, Rig, View
from rcs.errors import InvalidSetup
from rcs.spatial import Intrinsics


@dataclass(frozen=True, kw_only=True)
class Verification:
    """How well a calibration holds. Each number is the median over all views."""

    views: int
    """Views that showed the board."""
    pixels: float
    """Distance of a tag's corners from where they are expected [px]."""
    millimetres: float
    """Distance of the board from where it is expected [mm], with the error of seeing it in one view."""
    degrees: float
    """The same of its rotation [degrees]."""


def verify(rig: Rig, board: Board, views: Sequence[View]) -> Verification:
    """Compare views with what is expected of a camera and a board whose places are known.

    Args:
        rig: Where camera and board are, and how the camera sees.
        board: The board.
        views: What was seen; views without tags do not count.

    Raises:
        InvalidSetup: The place of the board is not known, or no view shows it.
    """
    if rig.board_in_anchor is None:
        raise InvalidSetup("The place of the board is not known, so there is nothing to compare with.")
    usable = [view for view in views if len(view.detections)]
    if not usable:
        raise InvalidSetup(f"None of {len(views)} pictures shows the board; is it where it was?")
    guess = Guess(rig.camera_in_mount, rig.board_in_anchor)
    off = [board_offset(guess, board, view, rig.arrangement, rig.intrinsics) for view in usable]
    millimetres, degrees = (float(np.median(values)) for values in zip(*off, strict=True))
    pixels = tag_errors(guess, Sightings.of(board, usable, rig.arrangement, rig.intrinsics))
    return Verification(
        views=len(usable),
        pixels=float(np.median(pixels)),
        millimetres=millimetres,
        degrees=degrees,
    )


def board_offset(
    guess: Guess, board: Board, view: View, arrangement: Arrangement, intrinsics: Intrinsics
) -> tuple[float, float]:
    """Return how far the board in a view is from where it is expected [mm, degrees].

    Args:
        guess: Where camera and board are.
        board: The board.
        view: What was seen.
        arrangement: What carries the camera.
        intrinsics: How it sees.
    """
    expected = rigid(guess.boards_in_camera(view.anchor_in_mount(arrangement)))
    found = [rigid(one.board_in_camera) for one in board_poses(board, view.detections, intrinsics)]
    # A flipped board is an error of that picture alone: the one that is meant is the nearer one.
    nearest = min((moved_by(expected, one) for one in found), key=lambda step: float(np.linalg.norm(step[3:])))
    return 1000 * float(np.linalg.norm(nearest[:3])), float(np.rad2deg(np.linalg.norm(nearest[3:])))
