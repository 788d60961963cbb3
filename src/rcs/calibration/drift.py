"""Whether a camera still is where its calibration says: a board in a known place, seen where it is expected or not."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from rcs.calibration.board import Board
from rcs.calibration.board_pose import project
from rcs.calibration.detection import Detections
from rcs.errors import InvalidSetup
from rcs.spatial import Intrinsics


def reprojection_errors(
    board: Board, board_in_camera: NDArray[np.float64], found: Detections, intrinsics: Intrinsics
) -> NDArray[np.float64]:
    """Return how far the tags of a board are from where they are expected [px], (n,): the mean of each one's corners.

    Args:
        board: The board.
        board_in_camera: Where it is expected in the optical frame, (4, 4).
        found: Its tags in a picture.
        intrinsics: Of the picture.
    """
    off = project(board_in_camera, board.corners_of(found.ids)) - found.rays(intrinsics)
    return np.linalg.norm(off * (intrinsics.fx, intrinsics.fy), axis=-1).mean(axis=-1)


class Drift:
    """Judges the errors of the last pictures: a single bad one is no drift, and a lasting offset is."""

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
        """Take the errors of a picture's tags [px], (n,); a picture without tags says nothing."""
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
