"""The gel of a tactile sensor as its camera sees it: its shape at rest and under an object, and its image.

All maps are images. The camera looks along the sensor's x axis, and depth is the distance from it along x. Like a
DIGIT's, images lie on their side: columns run along +z and rows along -y; `numpy.rot90` turns one upright. Objects are
found on a grid of rays coarser than the image, since the gel rounds off finer details.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rcs.robots.tactile import TactileDescription

Image = NDArray[np.float32]
GelImage = NDArray[np.uint8]

RAY_PITCH = 2
"""Pixels of the image per ray, in both directions."""
FINEST_DETAIL = 0.16e-3
"""Standard deviation of the blur with which the gel's skin follows an object [m]; our choice, two pixels."""
SKIRT = 0.2e-3
"""Standard deviation of the blur by which the gel next to a contact is pulled along [m].

Our choice: next to a steep wall the skirt is as bright as the contact, so a wider one would enlarge the patch of a
small ball; with this one, the patch of a ball of 2 mm at 80 % of its radius is within 10 %.
"""
STILL = 1e-7
"""Displacements below this are set to 0 [m]: they change no colour, and bits far from a contact stay the same."""
AMBIENT = 0.22
"""Ambient light as a share of full brightness; our choice, since real frames are nowhere black."""
DIFFUSE = 0.40
"""Share of full brightness that a light adds to a surface facing it in the middle of the gel; our choice."""


class Gel:
    """The gel's rest surface, and its deformation under objects that penetrate it."""

    def __init__(self, sensor: TactileDescription) -> None:
        """Compute the rest surface along every ray and in every pixel.

        Args:
            sensor: The sensor with the gel.
        """
        self._sensor = sensor
        self._half_slope = math.tan(0.5 * sensor.camera_yfov)
        """Slope of the rays through the middle of the image's left and right edge."""
        self.size = width, height = sensor.frame_size
        self.grid = (height // RAY_PITCH, width // RAY_PITCH)
        """Rows and columns of the rays."""
        self.slopes = self._slopes(height, width)
        """Sideways distance per depth of every pixel: along y (height, 1) and along z (1, width)."""
        slope_y, slope_z = self._slopes(*self.grid)
        self.rest = self.depth_at_rest(*self.slopes).astype(np.float32)
        """Depth of the rest surface in every pixel [m], (height, width)."""
        self.ray_slopes = np.broadcast_arrays(np.ones(self.grid), slope_y, slope_z)
        """x, y and z of every ray's direction, with x = 1, each (rows, columns)."""
        self.ray_rest = self.depth_at_rest(slope_y, slope_z)
        """Depth of the rest surface along every ray [m], (rows, columns)."""
        self._ray_distance = float(self.rest[height // 2, width // 2]) * 2 * self._half_slope / self.grid[1]

    def _slopes(self, rows: int, columns: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the slopes of the rays through the centres of an image's pixels; pixels are square."""
        per_pixel = 2 * self._half_slope / columns
        slope_y = -per_pixel * (np.arange(rows, dtype=np.float64) + 0.5 - rows / 2)
        slope_z = per_pixel * (np.arange(columns, dtype=np.float64) + 0.5 - columns / 2)
        return slope_y[:, None], slope_z[None, :]

    def pixels(
        self, slope_y: NDArray[np.float64], slope_z: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return rows and columns of rays in the image, with the centre of the top left pixel at (0, 0)."""
        width, height = self.size
        focal = width / (2 * self._half_slope)
        return height / 2 - 0.5 - focal * slope_y, width / 2 - 0.5 + focal * slope_z

    def surface(self, y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the x of the rest surface [m] at y and z [m], all in the sensor's frame.

        It is the cap of a sphere, stretched along x so that the gel's corners are as low as they are (Tacto 0.0.3).
        """
        sensor = self._sensor
        radius = sensor.gel_curvature_radius
        x0, y0, z0 = sensor.gel_center
        corner = radius - math.sqrt(radius**2 - 0.25 * (sensor.gel_width**2 + sensor.gel_height**2))
        fall = radius - np.sqrt(np.maximum(radius**2 - (y - y0) ** 2 - (z - z0) ** 2, 0.0))
        return x0 - sensor.gel_bulge / corner * fall

    def depth_at_rest(self, slope_y: NDArray[np.float64], slope_z: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the depth [m] at which rays from the camera meet the rest surface."""
        x0, y0, z0 = self._sensor.camera_position
        depth = np.full(np.broadcast_shapes(slope_y.shape, slope_z.shape), self._sensor.gel_center[0] - x0)
        # The surface falls off by less than a ray moves sideways, so the iteration contracts, to machine precision.
        for _ in range(60):
            depth = self.surface(y0 + depth * slope_y, z0 + depth * slope_z) - x0
        return depth

    def penetration(self, depth: NDArray[np.float64], coarser: int = 1) -> NDArray[np.float64]:
        """Return how far an object penetrates the rest surface.

        Args:
            depth: Depth at which rays meet an object [m], infinite where there is none.
            coarser: 1 for every ray of the grid, 2 for every second in both directions, and so on.

        Returns:
            Distance along x between the rest surface and the object [m]: positive where the object is inside the gel,
            minus infinity where there is none.
        """
        x0, y0, z0 = self._sensor.camera_position
        _, slope_y, slope_z = (slope[::coarser, ::coarser] for slope in self.ray_slopes)
        found = np.isfinite(depth)
        near = np.where(found, depth, 0.0)
        return np.where(found, self.surface(y0 + near * slope_y, z0 + near * slope_z) - x0 - near, -np.inf)

    def displacement(self, depth: NDArray[np.float64]) -> Image:
        """Return how far the gel's surface moves towards the camera.

        The surface follows the object where they touch. Next to it, the skin is pulled along and returns within half a
        millimetre; it also rounds off fine details.

        Args:
            depth: Depth at which each ray meets an object [m], infinite where there is none, (rows, columns).

        Returns:
            Displacement along the optical axis [m], (height, width), exactly 0 without contact.
        """
        pressed = np.clip(self.ray_rest - depth, 0.0, self._sensor.max_indentation).astype(np.float32)
        pulled = np.maximum(pressed, _blur(pressed, SKIRT / self._ray_distance))
        smooth = _blur(pulled, FINEST_DETAIL / self._ray_distance, RAY_PITCH)
        smooth[smooth < STILL] = 0.0
        return smooth


def _blur(image: Image, sigma: float, finer: int = 1) -> Image:
    """Blur an image with a Gaussian and enlarge it `finer` times in the same pass.

    Uses slices, since NumPy's matrix products take a hundred times as long when the CPU's cores are busy.

    Args:
        image: Values along two axes; edge values continue beyond the edge.
        sigma: Standard deviation in the image's own steps.
        finer: Values of the result per value of the image, along each axis.
    """
    return _blur_rows(_blur_rows(image, sigma, finer).T, sigma, finer).T


def _blur_rows(image: Image, sigma: float, finer: int) -> Image:
    """Blur along the first axis."""
    reach = math.ceil(4.0 * sigma)
    padded = np.pad(image, ((reach, reach), (0, 0)), mode="edge")
    blurred = np.empty((len(image) * finer, image.shape[1]), np.float32)
    for phase in range(finer):
        place = (phase + 0.5) / finer - 0.5
        weights = np.exp(-0.5 * ((np.arange(-reach, reach + 1) - place) / sigma) ** 2)
        weights = (weights / weights.sum()).astype(np.float32)
        row = weights[0] * padded[: len(image)]
        for start, weight in enumerate(weights[1:], 1):
            row += weight * padded[start : start + len(image)]
        blurred[phase::finer] = row
    return blurred


class GelLight:
    """Lambert's law for the sensor's lights, which fall off with the square of the distance.

    Only the change from the gel at rest is computed and added to the background, so pixels without contact keep every
    bit.
    """

    def __init__(self, sensor: TactileDescription, gel: Gel) -> None:
        """Light the gel at rest.

        Args:
            sensor: Has the lights.
            gel: The gel that they light.
        """
        width, height = gel.size
        camera = np.array(sensor.camera_position)
        self._places = (np.array([light.position for light in sensor.lights]) - camera).astype(np.float32)
        middle = np.array([gel.rest[height // 2, width // 2], 0.0, 0.0])
        distances = np.linalg.norm(self._places - middle, axis=1)
        colours = np.array([light.color for light in sensor.lights])
        self._colours = (255.0 * DIFFUSE * colours * distances[:, None] ** 2).astype(np.float32)
        self._gel = gel
        self._slope_y, self._slope_z = (slope.astype(np.float32) for slope in gel.slopes)
        self._at_rest = self._light(gel.rest, slice(0, height), slice(0, width))
        self.background: GelImage = np.clip(255.0 * AMBIENT + self._at_rest + 0.5, 0.0, 255.0).astype(np.uint8)
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
