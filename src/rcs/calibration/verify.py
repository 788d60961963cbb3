"""Checks of a calibration: by views that it was not made from, and by the drift of a board in a known place."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rcs.calibration.board import Board
from rcs.calibration.board_pose import board_poses, project
from rcs.calibration.closed_form import rigid
from rcs.calibration.detection import Detections
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
    """Return the offset of the board in a view from its expected pose [mm, degrees].

    Args:
        guess: Poses of camera and board.
        board: The board.
        view: The view.
        arrangement: What carries the camera.
        intrinsics: Intrinsics of the camera.
    """
    expected = rigid(guess.boards_in_camera(view.anchor_in_mount(arrangement)))
    found = [rigid(one.board_in_camera) for one in board_poses(board, view.detections, intrinsics)]
    # A flipped board is an error of that picture alone: the one that is meant is the nearer one.
    nearest = min((moved_by(expected, one) for one in found), key=lambda step: float(np.linalg.norm(step[3:])))
    return 1000 * float(np.linalg.norm(nearest[:3])), float(np.rad2deg(np.linalg.norm(nearest[3:])))


def reprojection_errors(
    board: Board, board_in_camera: NDArray[np.float64], found: Detections, intrinsics: Intrinsics
) -> NDArray[np.float64]:
    """Return the distance of each tag of a board from its expected place [px], (n,): the mean of its corners.

    Args:
        board: The board.
        board_in_camera: Expected pose of the board in the optical frame, (4, 4).
        found: Its tags in an image.
        intrinsics: Intrinsics of the image.
    """
    off = project(board_in_camera, board.corners_of(found.ids)) - found.rays(intrinsics)
    return np.linalg.norm(off * (intrinsics.fx, intrinsics.fy), axis=-1).mean(axis=-1)


class Drift:
    """Judges the errors of the last images: a single bad one is no drift, a lasting offset is."""

    def __init__(self, *, limit_px: float = 2.0, window: int = 15, fewest: int = 5) -> None:
        """Begin without a picture.

        Args:
            limit_px: Median error from which the calibration no longer holds [px].
            window: Pictures that count, the last ones.
            fewest: Pictures with tags before which nothing is said.

        Raises:
            InvalidSetup: A number makes no sense.
        """
        if not (limit_px > 0 and 1 <= fewest <= window):
            raise InvalidSetup(
                f"limit_px is {limit_px!r}, window {window!r}, fewest {fewest!r}; valid are a positive limit, and 1 <= "
                "fewest <= window."
            )
        self.limit_px = limit_px
        self._fewest = fewest
        self._errors: deque[float] = deque(maxlen=window)

    def add(self, errors: NDArray[np.float64]) -> None:
        """Add the errors of an image's tags [px], (n,); an image without tags does not count."""
        if len(errors):
            self._errors.append(float(np.median(errors)))

    @property
    def pixels(self) -> float:
        """Median error of the last pictures [px]; NaN before the first."""
        return float(np.median(self._errors)) if self._errors else float("nan")

    @property
    def is_off(self) -> bool:
        """Whether the calibration no longer holds."""
        return len(self._errors) >= self._fewest and self.pixels > self.limit_px
