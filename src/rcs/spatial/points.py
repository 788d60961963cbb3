"""Points in space from depth images, simulated, recorded or real."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs.errors import InvalidSetup
from rcs.spatial.pinhole import pixel_rays


class PointCloud(NamedTuple):
    """Points that were seen, one for each valid pixel, row by row from the top."""

    points: NDArray[np.float32]
    """Positions [m], shape (n, 3)."""
    colours: NDArray[np.uint8] | None
    """Red, green, blue, shape (n, 3); None without a colour image."""


def point_cloud(
    depth: NDArray[Any],
    intrinsics: ArrayLike,
    extrinsics: ArrayLike | None = None,
    rgb: NDArray[np.uint8] | None = None,
    mask: NDArray[np.bool_] | None = None,
    *,
    distortion: ArrayLike | None = None,
) -> PointCloud:
    """Return the points that one depth image shows. Pixels without a valid depth give no point.

    Args:
        depth: Along the optical axis, shape (H, W): whole numbers are millimetres and 0 is invalid; floating ones are
            metres, and what is not positive or not finite is invalid.
        intrinsics: Camera matrix [px], shape (3, 3).
        extrinsics: Pose of the camera (x right, y down, z forward) in the frame of the points, shape (4, 4), such as
            `frames`/camera/`extrinsics`; None for points in the camera's own frame.
        rgb: Colours of the same pixels, shape (H, W, 3).
        mask: Pixels to take, shape (H, W), such as `segmentation == 3`; None for all.
        distortion: The lens's k1, k2, p1, p2, k3, such as `frames`/camera/`distortion`; None for a lens without.

    Raises:
        InvalidSetup: A shape does not fit; or the distortion does not fit the picture.

    Examples:
        >>> import numpy as np
        >>> depth = np.full((2, 2), 1000, np.uint16)
        >>> matrix = [[100.0, 0.0, 0.5], [0.0, 100.0, 0.5], [0.0, 0.0, 1.0]]
        >>> point_cloud(depth, matrix).points.shape
        (4, 3)
    """
    depth = np.asarray(depth)
    if depth.ndim != 2:
        raise InvalidSetup(f"depth has shape {depth.shape}; valid is (H, W), one image at a time.")
    for name, given, shape in (("rgb", rgb, (*depth.shape, 3)), ("mask", mask, depth.shape)):
        if given is not None and given.shape != shape:
            raise InvalidSetup(f"{name} has shape {given.shape}; valid is {shape}, that of the depth's pixels.")
    points = deproject(depth, intrinsics, extrinsics, distortion=distortion)
    is_seen = np.isfinite(points[..., 2])
    if mask is not None:
        is_seen &= np.asarray(mask, np.bool_)
    return PointCloud(points[is_seen], None if rgb is None else rgb[is_seen])


def deproject(
    depth: NDArray[Any],
    intrinsics: ArrayLike,
    extrinsics: ArrayLike | None = None,
    *,
    distortion: ArrayLike | None = None,
    invalid: float = np.nan,
) -> NDArray[np.float32]:
    """Return the point that each pixel of depth images shows [m], float32, shape (..., H, W, 3).

    Args:
        depth: Along the optical axis, shape (..., H, W), as in `point_cloud`.
        intrinsics: Camera matrices [px], shape (..., 3, 3).
        extrinsics: Poses of the cameras in the frame of the points, shape (..., 4, 4); None for the camera's own frame.
        distortion: k1, k2, p1, p2, k3, shape (..., 5); None for lenses without.
        invalid: The coordinates of pixels without a valid depth.

    Raises:
        InvalidSetup: A shape does not fit; or a distortion does not fit the picture.
    """
    depth = np.asarray(depth)
    if depth.ndim < 2 or depth.dtype.kind not in "uif":
        raise InvalidSetup(f"depth is {depth.shape} {depth.dtype}; valid are (..., H, W) whole [mm] or floating [m].")
    leading, (height, width) = depth.shape[:-2], depth.shape[-2:]
    matrices = _per_image("intrinsics", intrinsics, leading, (3, 3))
    poses = None if extrinsics is None else _per_image("extrinsics", extrinsics, leading, (4, 4))
    lens = np.asarray(() if distortion is None else distortion, np.float64)
    lenses = _per_image("distortion", lens, leading, lens.shape[-1:])
    points = np.empty((*depth.shape, 3), np.float32)
    for index in np.ndindex(leading):  # a single image has no leading axis
        rays = pixel_rays(matrices[index], (width, height), lenses[index])
        z = depth[index].astype(np.float64) * (1.0 if depth.dtype.kind == "f" else 1e-3)
        is_seen = np.isfinite(z) & (z > 0)
        axes = (rays[..., 0] * z, rays[..., 1] * z, z)
        for i in range(3):
            values = axes[i]
            if poses is not None:
                row = poses[index][i]
                # Not a product of matrices, whose last bit may depend on the number of threads.
                values = axes[0] * row[0] + axes[1] * row[1] + axes[2] * row[2] + row[3]
            points[index][..., i] = np.where(is_seen, values, invalid)
    return points


def _per_image(name: str, given: ArrayLike, leading: tuple[int, ...], shape: tuple[int, ...]) -> NDArray[np.float64]:
    values = np.asarray(given, np.float64)
    own = values.ndim - len(shape)
    if values.shape[own:] != shape or values.shape[:own] not in ((), leading):
        raise InvalidSetup(f"{name} has shape {values.shape}; valid is {shape} or {(*leading, *shape)}.")
    return np.broadcast_to(values, (*leading, *shape))
