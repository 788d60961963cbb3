"""How a camera maps directions to pixels: focal lengths, principal point and distortion, as in OpenCV.

A direction in the camera's optical frame (x right, y down, z forward) has the normalised coordinates x / z and y / z.
The lens moves them, and the camera matrix makes pixels of them; the centre of the top left pixel is (0, 0). Distortion
has five coefficients, k1, k2, p1, p2, k3, in OpenCV's order: with r² = x² + y²,

    x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)
    y' = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y

(OpenCV documentation, "Camera Calibration and 3D Reconstruction").
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rcs_data.options import Positive, Record, Whole, converted

from rcs.errors import InvalidSetup

COEFFICIENTS = 5
"""Length of a distortion: k1, k2, p1, p2, k3."""

_NEWTON_STEPS = 50
_CONVERGED = 1e-12


def five_coefficients(distortion: ArrayLike | None) -> tuple[float, ...]:
    """Return a distortion as k1, k2, p1, p2, k3.

    Args:
        distortion: Four or more of OpenCV's coefficients, those after the fifth zero; None, or no number, for a lens
            without.

    Raises:
        InvalidSetup: There is another number of them, one is not finite, or one after the fifth is not zero.
    """
    given = np.asarray(() if distortion is None else distortion, np.float64).reshape(-1)
    if len(given) not in (0, 4, 5, 8, 12, 14) or not np.isfinite(given).all() or given[COEFFICIENTS:].any():
        raise InvalidSetup(
            f"distortion is {given.tolist()}; valid are the numbers k1, k2, p1, p2 and k3, or none. Models with more "
            "coefficients and of fisheye lenses are not drawn; calibrate with these five (OpenCV's default)."
        )
    k1, k2, p1, p2, k3 = (float(value) for value in [*given[:COEFFICIENTS], *([0.0] * COEFFICIENTS)][:COEFFICIENTS])
    return k1, k2, p1, p2, k3


class Intrinsics(Record):
    """Intrinsics of pictures of one size."""

    width: Whole
    """[px]."""
    height: Whole
    """[px]."""
    fx: Positive
    """Focal length along x [px]."""
    fy: Positive
    """Focal length along y [px]."""
    cx: float
    """Column of the principal point [px]."""
    cy: float
    """Row of the principal point [px]."""
    distortion: tuple[float, ...] = converted(converter=five_coefficients, default=())
    """k1, k2, p1, p2, k3."""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidSetup: A size or focal length is not positive, a number is not finite, the principal point is not in
                the picture, or there is another number of coefficients.
        """
        super().__post_init__()
        if not (-0.5 <= self.cx <= self.width - 0.5 and -0.5 <= self.cy <= self.height - 0.5):
            raise InvalidSetup(
                f"The principal point is ({self.cx}, {self.cy}) px; valid is a point in a picture of {self.width} x "
                f"{self.height} px."
            )

    @staticmethod
    def of_matrix(matrix: ArrayLike, size: tuple[int, int], distortion: ArrayLike | None = None) -> Intrinsics:
        """Return the intrinsics with a camera matrix.

        Args:
            matrix: Camera matrix [px], shape (3, 3).
            size: Width and height of the pictures [px].
            distortion: Four or five coefficients; None for a lens without.

        Raises:
            InvalidSetup: The matrix is skewed or otherwise not that of a camera.
        """
        k = np.asarray(matrix, np.float64)
        if k.shape != (3, 3) or k[0, 1] != 0 or k[1, 0] != 0 or list(k[2]) != [0, 0, 1]:
            raise InvalidSetup(
                f"The camera matrix is {k.tolist()}; valid is [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels."
            )
        width, height = size
        return Intrinsics(
            width=width,
            height=height,
            fx=float(k[0, 0]),
            fy=float(k[1, 1]),
            cx=float(k[0, 2]),
            cy=float(k[1, 2]),
            distortion=five_coefficients(distortion),
        )

    @property
    def matrix(self) -> NDArray[np.float64]:
        """Camera matrix [px], shape (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def is_distorted(self) -> bool:
        """True if any coefficient is not zero."""
        return any(self.distortion)

    def cut(self, size: tuple[int, int]) -> Intrinsics:
        """Return the intrinsics of pictures that are cut out of the middle of these, in another shape, and scaled.

        Args:
            size: Width and height of those pictures [px].
        """
        rows, columns = cropped((self.width, self.height), size)
        across = size[0] / (columns.stop - columns.start)
        down = size[1] / (rows.stop - rows.start)
        return Intrinsics(
            width=size[0],
            height=size[1],
            fx=self.fx * across,
            fy=self.fy * down,
            cx=(self.cx - columns.start + 0.5) * across - 0.5,
            cy=(self.cy - rows.start + 0.5) * down - 0.5,
            distortion=self.distortion,
        )


def cropped(source: tuple[int, int], target: tuple[int, int]) -> tuple[slice, slice]:
    """Return the rows and columns of the largest middle part of a picture that has another picture's shape.

    Args:
        source: Width and height of the picture [px].
        target: Width and height of the other one [px].
    """
    scale = min(source[0] / target[0], source[1] / target[1])
    width, height = max(1, round(target[0] * scale)), max(1, round(target[1] * scale))
    left, top = (source[0] - width) // 2, (source[1] - height) // 2
    return slice(top, top + height), slice(left, left + width)


def distort(points: ArrayLike, distortion: ArrayLike) -> NDArray[np.float64]:
    """Return where a lens moves normalised coordinates.

    Args:
        points: x / z and y / z of directions, shape (..., 2).
        distortion: k1, k2, p1, p2, k3.
    """
    x, y = np.moveaxis(np.asarray(points, np.float64), -1, 0)
    k1, k2, p1, p2, k3 = np.asarray(distortion, np.float64)
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y],
        axis=-1,
    )


def undistort(points: ArrayLike, distortion: ArrayLike) -> NDArray[np.float64]:
    """Return the normalised coordinates that a lens moves to given ones, by Newton's method; inverse of `distort`.

    Args:
        points: Normalised coordinates as the lens makes them, shape (..., 2).
        distortion: k1, k2, p1, p2, k3.

    Raises:
        InvalidSetup: A point is beyond what the model of the lens can make: it folds the picture over there.
    """
    target = np.asarray(points, np.float64)
    k1, k2, p1, p2, k3 = np.asarray(distortion, np.float64)
    x, y = np.moveaxis(target.copy(), -1, 0)
    step = np.inf
    for _ in range(_NEWTON_STEPS):
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = k1 + r2 * (2 * k2 + r2 * 3 * k3)  # of `radial` along r²
        error_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) - target[..., 0]
        error_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y - target[..., 1]
        xx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
        xy = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
        yy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
        determinant = xx * yy - xy * xy
        if not (determinant > 0).all():
            break
        dx, dy = (yy * error_x - xy * error_y) / determinant, (xx * error_y - xy * error_x) / determinant
        x, y = x - dx, y - dy
        step = float(np.max(np.abs([dx, dy]), initial=0.0))
        if step < _CONVERGED:
            break
    found = np.stack([x, y], axis=-1)
    if not step < _CONVERGED or (np.hypot(x, y) >= fold_radius((k1, k2, k3))).any():
        raise InvalidSetup(
            f"distortion {np.asarray(distortion).tolist()} folds the picture over before its corners; valid is one "
            "that was fitted to points in the whole picture."
        )
    return found


def fold_radius(radial: tuple[float, float, float]) -> float:
    """Return the radius x / z from which a lens moves points inwards that are farther out; infinity if there is none.

    Args:
        radial: k1, k2, k3.
    """
    k1, k2, k3 = radial
    roots = np.roots([7 * k3, 5 * k2, 3 * k1, 1.0])
    squares = [root.real for root in np.atleast_1d(roots) if abs(root.imag) < 1e-12 and root.real > 0]
    return float(np.sqrt(min(squares))) if squares else np.inf


def pixel_rays(
    intrinsics: ArrayLike, size: tuple[int, int], distortion: ArrayLike | None = None
) -> NDArray[np.float64]:
    """Return where each pixel looks, as a read-only array: x / z and y / z in the optical frame, shape (H, W, 2).

    Args:
        intrinsics: Camera matrix [px], shape (3, 3).
        size: Width and height of the picture [px].
        distortion: k1, k2, p1, p2, k3; None for a lens without.

    Raises:
        InvalidSetup: The distortion makes no sense for this picture.
    """
    matrix = np.ascontiguousarray(intrinsics, np.float64)
    return _pixel_rays(matrix.tobytes(), size, five_coefficients(distortion))


@lru_cache(maxsize=8)
def _pixel_rays(matrix: bytes, size: tuple[int, int], distortion: tuple[float, ...]) -> NDArray[np.float64]:
    k = np.frombuffer(matrix).reshape(3, 3)
    rays = np.empty((size[1], size[0], 2))
    rays[..., 0] = (np.arange(size[0]) - k[0, 2]) / k[0, 0]
    rays[..., 1] = ((np.arange(size[1]) - k[1, 2]) / k[1, 1])[:, None]
    if any(distortion):
        rays = undistort(rays, distortion)
    rays.flags.writeable = False
    return rays
