"""A board of AprilTags: its tags, their corners, and its image.

The frame of a board has its origin in the middle, x to the right and y up as printed, and z out of the printed side.
Tags are of the family 36h11 (Olson, "AprilTag: A robust and flexible visual fiducial system", ICRA 2011); their numbers
count from the top left, row by row.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray
from rcs_data.options import Natural, Positive, Record, Whole

from rcs.errors import InvalidSetup
from rcs.extras import package_of

FAMILY = "tag36h11"
"""Family of the tags."""
TAGS = 587
"""Number of tags in the family."""
CELLS = 8
"""Cells along the edge of a tag's black square, of which the outer ones are its frame."""


class Board(Record):
    """A flat board with a grid of tags; as it is by default it fits on a sheet of A4."""

    rows: Whole = 2
    """Rows of tags."""
    columns: Whole = 2
    """Columns of tags."""
    tag_size: Annotated[float, Meta(ge=0.005, le=1.0)] = 0.08
    """Edge of a tag's black square [m]. Measure it on the print: an error of 1 % is one of 1 % in every distance."""
    gap: Positive = 0.02
    """White between two tags, and half of it around all [m]; at least two cells of a tag."""
    first_id: Natural = 0
    """Number of the tag at the top left."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidSetup: A number is out of range; the message says what is valid.
        """
        super().__post_init__()
        if self.first_id + self.rows * self.columns > TAGS:
            raise InvalidSetup(
                f"{self.rows} x {self.columns} tags from number {self.first_id} on are more than the family {FAMILY} "
                f"has, {TAGS}; choose fewer tags or a smaller first_id."
            )
        least = 2 * self.tag_size / CELLS
        if self.gap < least - 1e-12:
            raise InvalidSetup(
                f"gap is {self.gap!r} m; valid is at least {least:g} m, two cells of a tag: without white around it, "
                "a tag is not found."
            )

    @property
    def ids(self) -> list[int]:
        """Numbers of its tags."""
        return list(range(self.first_id, self.first_id + self.rows * self.columns))

    @property
    def size(self) -> tuple[float, float]:
        """Width and height with the white around all tags [m]."""
        pitch = self.tag_size + self.gap
        return self.columns * pitch, self.rows * pitch

    @property
    def corners(self) -> NDArray[np.float64]:
        """Corners of the tags in the board's frame [m], (tags, 4, 3): top left, then clockwise as printed."""
        pitch, half = self.tag_size + self.gap, self.tag_size / 2
        column, row = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        middle = np.stack(
            [
                (column.ravel() - (self.columns - 1) / 2) * pitch,
                ((self.rows - 1) / 2 - row.ravel()) * pitch,
                np.zeros(column.size),
            ],
            axis=-1,
        )
        return middle[:, None, :] + half * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])

    def corners_of(self, ids: NDArray[np.int_]) -> NDArray[np.float64]:
        """Return the corners of some of its tags [m], (n, 4, 3).

        Args:
            ids: Numbers of tags, (n,).
        """
        return self.corners[np.asarray(ids, np.int_) - self.first_id]

    def cells(self, number: int) -> NDArray[np.bool_]:
        """Return which cells of a tag are black, (8, 8), rows from the top.

        Args:
            number: Number of the tag.

        Raises:
            MissingDependency: OpenCV, which knows the family, is not installed.
        """
        aruco = package_of("calibration", "cv2").aruco
        family = aruco.getPredefinedDictionary(aruco.DICT_APRILTAG_36h11)
        return np.asarray(aruco.generateImageMarker(family, number, CELLS)) == 0

    def picture(self, pixels_per_cell: int = 16) -> NDArray[np.uint8]:
        """Return an image of the board, grey, rows from the top, its whole `size`.

        Args:
            pixels_per_cell: Pixels along the edge of a cell; the gap is rounded to whole pixels.
        """
        edge = CELLS * pixels_per_cell
        pitch = edge + 2 * round(self.gap / self.tag_size * edge / 2)
        picture = np.full((self.rows * pitch, self.columns * pitch), 255, np.uint8)
        for i, number in enumerate(self.ids):
            top, left = (index * pitch + (pitch - edge) // 2 for index in divmod(i, self.columns))
            black = self.cells(number).repeat(pixels_per_cell, 0).repeat(pixels_per_cell, 1)
            picture[top : top + edge, left : left + edge][black] = 0
        return picture
