"""The image of a tactile sensor's gel: coloured lights on the deformed surface, over a background frame."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.robots.tactile import TactileDescription
from rcs.sim.gel import Gel, Image

GelImage = NDArray[np.uint8]

AMBIENT = 0.22
"""Ambient light as a share of full brightness; our choice, since real frames are nowhere black."""
DIFFUSE = 0.40
"""Share of full brightness that a light adds to a surface facing it in the middle of the gel; our choice."""


class GelRenderer(Protocol):
    """Turns displacements of the gel into camera frames."""

    def draw(self, displacement: Image) -> GelImage:
        """Return the frame (height, width, 3) of a displacement towards the camera [m] (height, width)."""
        ...

    def close(self) -> None:
        """Free resources. Closing twice is harmless."""
        ...


class GelLight:
    """Lambert's law for the sensor's lights, which fall off with the square of the distance.

    Only the change from the gel at rest is computed and added to the background. So a real sensor's background frame
    can be used, and pixels without contact keep every bit.
    """

    def __init__(self, sensor: TactileDescription, gel: Gel, background: GelImage | None = None) -> None:
        """Light the gel at rest.

        Args:
            sensor: Has the lights.
            gel: The gel that they light.
            background: A frame without contact, (height, width, 3); None to compute it from the lights.

        Raises:
            InvalidSetup: The background has the wrong shape or dtype.
        """
        width, height = gel.size
        if background is not None and (background.shape != (height, width, 3) or background.dtype != np.uint8):
            raise InvalidSetup(
                f"The background is {background.dtype} {background.shape}; valid is uint8 ({height}, {width}, 3)."
            )
        camera = np.array(sensor.camera_position)
        self._places = (np.array([light.position for light in sensor.lights]) - camera).astype(np.float32)
        middle = np.array([gel.rest[height // 2, width // 2], 0.0, 0.0])
        distances = np.linalg.norm(self._places - middle, axis=1)
        colours = np.array([light.color for light in sensor.lights])
        colours *= np.array([light.intensity for light in sensor.lights])[:, None]
        self._colours = (255.0 * DIFFUSE * colours * distances[:, None] ** 2).astype(np.float32)
        self._gel = gel
        self._slope_y, self._slope_z = (slope.astype(np.float32) for slope in gel.slopes)
        self._at_rest = self._light(gel.rest, slice(0, height), slice(0, width))
        if background is None:
            background = np.clip(255.0 * AMBIENT + self._at_rest + 0.5, 0.0, 255.0).astype(np.uint8)
        self.background: GelImage = background.copy()
        """The frame without contact, (height, width, 3)."""

    def draw(self, displacement: Image) -> GelImage:
        """Return the frame of a displacement, (height, width, 3)."""
        frame = self.background.copy()
        felt = displacement > 0.0
        rows, columns = _span(felt, 1), _span(felt, 0)
        if rows is None or columns is None:
            return frame
        depth = self._gel.rest[rows, columns] - displacement[rows, columns]
        change = self._light(depth, rows, columns) - self._at_rest[rows, columns]
        frame[rows, columns] = np.clip(frame[rows, columns] + np.rint(change), 0.0, 255.0)
        return frame

    def _light(self, depth: Image, rows: slice, columns: slice) -> Image:
        """Return the light reflected by a part of the gel, 0 … 255, (rows, columns, 3).

        Args:
            depth: Depth of the surface [m], (rows, columns).
            rows: Rows of the image that it covers.
            columns: Columns of the image that it covers.
        """
        x = depth
        y = self._slope_y[rows] * depth
        z = self._slope_z[:, columns] * depth
        # The normal is the cross product of the steps to the next row (-y) and to the next column (+z).
        x_row, x_column = np.gradient(x)
        y_row, y_column = np.gradient(y)
        z_row, z_column = np.gradient(z)
        nx = y_row * z_column - z_row * y_column
        ny = z_row * x_column - x_row * z_column
        nz = x_row * y_column - y_row * x_column
        normal_length = np.sqrt(nx * nx + ny * ny + nz * nz)
        reflected = np.zeros((*depth.shape, 3), np.float32)
        for (light_x, light_y, light_z), colour in zip(self._places, self._colours, strict=True):
            to_x, to_y, to_z = light_x - x, light_y - y, light_z - z
            distance_squared = to_x * to_x + to_y * to_y + to_z * to_z
            facing = np.maximum(nx * to_x + ny * to_y + nz * to_z, 0.0)
            lit = facing / (normal_length * distance_squared * np.sqrt(distance_squared))
            for channel in np.flatnonzero(colour):
                reflected[..., channel] += colour[channel] * lit
        return reflected

    def close(self) -> None:
        """Do nothing."""


def _span(flags: NDArray[np.bool_], across: int) -> slice | None:
    """Return the rows (across 1) or columns (0) with true flags, and two more on each side; None without any."""
    found = np.flatnonzero(flags.any(axis=across))
    if len(found) == 0:
        return None
    return slice(max(int(found[0]) - 2, 0), int(found[-1]) + 3)
