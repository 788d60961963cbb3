"""Finding the tags of a board in a picture.

The detector takes edges of tags for straight lines, which a lens bends: half a pixel in the middle of an edge moves the
corners by as much, and a camera by millimetres. So a picture of a known lens is straightened first, and the corners go
back through the lens to where they are in the picture.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs.calibration.board import FAMILY, Board
from rcs.errors import InvalidSetup
from rcs.extras import package_of
from rcs.spatial import Intrinsics, distort, undistort
from rcs.spatial.pinhole import fold_radius

LEAST_MARGIN = 25.0
"""Least contrast of a tag's cells against the decision between black and white (the detector's `decision_margin`)."""

_ORDER = [1, 0, 3, 2]
# The library's corners begin at the top right of a tag as OpenCV prints it, and go against the clock.

_BEYOND = 128
"""Shade of what a straightened picture does not show."""
_OUTSIDE = -1e4
"""A column or row outside of every picture [px]."""

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
    """Results of earlier calls of `rays`, kept because taking out the distortion takes time."""

    def __len__(self) -> int:
        """Return the number of tags."""
        return len(self.ids)

    def __getitem__(self, rows: Any) -> Detections:
        """Return some of them."""
        return Detections(self.ids[rows], self.corners[rows])

    def rays(self, intrinsics: Intrinsics) -> NDArray[np.float64]:
        """Return the directions of the corners, x / z and y / z in the optical frame, (n, 4, 2).

        Args:
            intrinsics: Intrinsics of the picture; its distortion is taken out.
        """
        if intrinsics not in self._rays:
            focal, centre = np.array([intrinsics.fx, intrinsics.fy]), np.array([intrinsics.cx, intrinsics.cy])
            seen = (self.corners - centre) / focal
            is_bent = intrinsics.is_distorted and len(self) > 0
            self._rays[intrinsics] = undistort(seen, intrinsics.distortion) if is_bent else seen
        return self._rays[intrinsics]


def detect(board: Board, picture: ArrayLike, lens: Intrinsics | None = None) -> Detections:
    """Find the tags of a board.

    Tags of other numbers are left out, and tags that are found twice, because one of them is not the board's.

    Args:
        board: The board.
        picture: Colours (H, W, 3) or grey (H, W), uint8, rows from the top.
        lens: Intrinsics of the picture; None if nobody knows them: corners in distorted pictures are then a little off.

    Raises:
        InvalidSetup: The picture has another shape or type, or another size than the lens has.
        MissingDependency: The detector is not installed.
    """
    shades = grey(picture)
    if lens is not None and shades.shape != (lens.height, lens.width):
        raise InvalidSetup(
            f"The picture has {shades.shape[1]} x {shades.shape[0]} px, its lens {lens.width} x {lens.height}; valid "
            "are intrinsics of the picture's size (`Intrinsics.cut` makes them)."
        )
    if lens is None or not lens.is_distorted:
        return _found(board, shades)
    lookup, first = _straightening(lens)
    # Linear: what is sharper rings at the edges and finds corners worse.
    linear = package_of("calibration", "cv2").INTER_LINEAR
    found = _found(board, package_of("calibration", "cv2").remap(shades, lookup, None, linear, borderValue=_BEYOND))
    focal, centre = np.array([lens.fx, lens.fy]), np.array([lens.cx, lens.cy])
    rays = (found.corners + first - centre) / focal
    return Detections(found.ids, distort(rays, lens.distortion) * focal + centre)


def grey(picture: ArrayLike) -> NDArray[np.uint8]:
    """Return a picture in shades of grey, (H, W).

    Args:
        picture: Colours (H, W, 3) or grey (H, W), uint8.

    Raises:
        InvalidSetup: It has another shape or type.
    """
    given = np.asarray(picture)
    if given.dtype != np.uint8 or given.ndim not in (2, 3) or (given.ndim == 3 and given.shape[2] != 3):
        raise InvalidSetup(
            f"A picture has shape {given.shape} and type {given.dtype}; valid is (H, W, 3) or (H, W), uint8."
        )
    if given.ndim == 2:
        return np.ascontiguousarray(given)
    # Weights of ITU-R BT.601.
    return np.ascontiguousarray(np.rint(given @ np.array([0.299, 0.587, 0.114])).astype(np.uint8))


def _found(board: Board, shades: NDArray[np.uint8]) -> Detections:
    """Return the tags in a picture with straight edges."""
    found = [
        tag
        for tag in _detector().detect(shades)
        if tag.hamming == 0 and tag.decision_margin >= LEAST_MARGIN and tag.tag_id in board.ids
    ]
    numbers = [tag.tag_id for tag in found]
    once = sorted((tag for tag in found if numbers.count(tag.tag_id) == 1), key=lambda tag: tag.tag_id)
    ids = np.array([tag.tag_id for tag in once], np.int_)
    # The library counts from the corner of the top left pixel, and not from its centre.
    corners = np.array([tag.corners[_ORDER] for tag in once], np.float64).reshape(-1, 4, 2) - 0.5
    return Detections(ids, corners)


@lru_cache(maxsize=4)
def _straightening(lens: Intrinsics) -> tuple[NDArray[np.float32], NDArray[np.int_]]:
    """Return how a picture is straightened, with the same focal lengths and all that it shows, up to twice its size.

    Returns:
        Where in the picture every pixel of the straight one is, (rows, columns, 2), far outside for what it does not
        show; and where the straight picture's first pixel would be in the picture, column and row.
    """
    radial = lens.distortion[0], lens.distortion[1], lens.distortion[4]

    def seen(columns: NDArray[np.int_], rows: NDArray[np.int_]) -> NDArray[np.float64]:
        pixels = np.stack(np.meshgrid(columns, rows), axis=-1)
        rays = (pixels - (lens.cx, lens.cy)) / (lens.fx, lens.fy)
        bent = distort(rays, lens.distortion) * (lens.fx, lens.fy) + (lens.cx, lens.cy)
        is_seen = np.linalg.norm(rays, axis=-1) < fold_radius(radial)
        is_seen &= ((bent > -1) & (bent < (lens.width, lens.height))).all(axis=-1)
        return np.where(is_seen[..., None], bent, _OUTSIDE)

    step = 4
    middle = round(lens.cx), round(lens.cy)
    columns, rows = (
        np.arange(at - size, at + size, step) for at, size in zip(middle, (lens.width, lens.height), strict=True)
    )
    is_seen = seen(columns, rows)[..., 0] > _OUTSIDE
    columns, rows = (
        np.arange(along[hit][0] - step, along[hit][-1] + step + 1)
        for along, hit in ((columns, is_seen.any(axis=0)), (rows, is_seen.any(axis=1)))
    )
    return seen(columns, rows).astype(np.float32), np.array([columns[0], rows[0]])


def _detector() -> Any:
    """Return the detector of this thread; one of them is not to be used by two."""
    if not hasattr(_local, "detector"):
        _local.detector = package_of("calibration", "pupil_apriltags").Detector(
            families=FAMILY, nthreads=1, quad_decimate=1.0, refine_edges=True
        )
        # At its end it frees the families that it knows, then writes into them (pupil-labs/apriltags#34).
        _local.detector.tag_families.clear()
    return _local.detector
