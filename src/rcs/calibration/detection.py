"""Finding the tags of a board in a picture."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs.calibration.board import FAMILY, Board
from rcs.calibration.packages import package
from rcs.errors import InvalidSetup
from rcs.spatial import Intrinsics, undistort

LEAST_MARGIN = 25.0
"""Least contrast of a tag's cells against the decision between black and white (the detector's `decision_margin`)."""

_ORDER = [1, 0, 3, 2]
# The library's corners begin at the top right of a tag as OpenCV prints it, and go against the clock.

_local = threading.local()


@dataclass(frozen=True, eq=False)
class Detections:
    """Tags found in one picture."""

    ids: NDArray[np.int_]
    """Their numbers, (n,)."""
    corners: NDArray[np.float64]
    """Their corners [px], (n, 4, 2): top left, top right, bottom right, bottom left as printed. The centre of the top
    left pixel is (0, 0)."""
    _rays: dict[Intrinsics, NDArray[np.float64]] = field(
        default_factory=dict[Intrinsics, NDArray[np.float64]], init=False, repr=False
    )
    """What `rays` has returned: taking out the distortion takes time."""

    def __len__(self) -> int:
        """Return the number of tags."""
        return len(self.ids)

    def __getitem__(self, rows: Any) -> Detections:
        """Return some of them."""
        return Detections(self.ids[rows], self.corners[rows])

    def rays(self, intrinsics: Intrinsics) -> NDArray[np.float64]:
        """Return the directions of the corners, x / z and y / z in the optical frame, (n, 4, 2).

        Args:
            intrinsics: Of the picture; its distortion is taken out.
        """
        if intrinsics not in self._rays:
            focal, centre = np.array([intrinsics.fx, intrinsics.fy]), np.array([intrinsics.cx, intrinsics.cy])
            seen = (self.corners - centre) / focal
            is_bent = intrinsics.is_distorted and len(self) > 0
            self._rays[intrinsics] = undistort(seen, intrinsics.distortion) if is_bent else seen
        return self._rays[intrinsics]


def detect(board: Board, picture: ArrayLike) -> Detections:
    """Find the tags of a board.

    Tags of other numbers are left out, and tags that are found twice, because one of them is not the board's.

    Args:
        board: The board.
        picture: Colours (H, W, 3) or grey (H, W), uint8, rows from the top.

    Raises:
        InvalidSetup: The picture has another shape or type.
        MissingDependency: The detector is not installed.
    """
    grey = _grey(np.asarray(picture))
    found = [
        tag
        for tag in _detector().detect(grey)
        if tag.hamming == 0 and tag.decision_margin >= LEAST_MARGIN and tag.tag_id in board.ids
    ]
    numbers = [tag.tag_id for tag in found]
    once = sorted((tag for tag in found if numbers.count(tag.tag_id) == 1), key=lambda tag: tag.tag_id)
    ids = np.array([tag.tag_id for tag in once], np.int_)
    # The library counts from the corner of the top left pixel, and not from its centre.
    corners = np.array([tag.corners[_ORDER] for tag in once], np.float64).reshape(-1, 4, 2) - 0.5
    return Detections(ids, corners)


def _detector() -> Any:
    """Return the detector of this thread; one of them is not to be used by two."""
    if not hasattr(_local, "detector"):
        _local.detector = package("pupil_apriltags").Detector(
            families=FAMILY, nthreads=1, quad_decimate=1.0, refine_edges=True
        )
    return _local.detector


def _grey(picture: NDArray[Any]) -> NDArray[np.uint8]:
    if picture.dtype != np.uint8 or picture.ndim not in (2, 3) or (picture.ndim == 3 and picture.shape[2] != 3):
        raise InvalidSetup(
            f"A picture has shape {picture.shape} and type {picture.dtype}; valid is (H, W, 3) or (H, W), uint8."
        )
    if picture.ndim == 2:
        return np.ascontiguousarray(picture)
    # Weights of ITU-R BT.601.
    return np.ascontiguousarray(np.rint(picture @ np.array([0.299, 0.587, 0.114])).astype(np.uint8))
