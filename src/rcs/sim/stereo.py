"""Depth as a stereo camera measures it, from depth without errors.

What is modelled, for cameras of the RealSense D400 series; 0 is no reading, as on the device:

- Noise: a disparity has a standard deviation of `SUBPIXEL`, so depth has one of z² / (f b) times that, with the focal
  length f of the picture and the baseline b (Intel, "Tuning depth cameras for best performance").
- Nothing nearer than the camera's nearest depth for this format (data sheet).
- Shadows: depth is that of the left eye, and what something nearer hides from the right one, b to the right of it, has
  no match: a band on the left of near objects, f b (1 / near - 1 / far) pixels wide.
- The invalid band: what is outside of the right eye's picture has no match either (data sheet, "Invalid depth band").
- Edges and grazing views: where depth changes from a pixel to the next as on a surface seen at more than `STEEPEST`
  from its normal, the two eyes see different things; `STEEP_LOSS` of these pixels have no reading.
- Darkness: below a brightness of `DARK`, a share of the pixels that grows to all in black has no reading.

The shares are assumptions, not measured. Not modelled: the errors of neighbours are independent, where a device smooths
them over its matching window; no wrong matches, no errors of calibration, no offset between the left eye and the colour
sensor, whose picture is that of the depth here; light, texture and the pattern projector change nothing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rcs.robots.description import CameraDescription

SUBPIXEL = 0.08
"""Standard deviation of a disparity [px]; Intel states 0.05 to 0.1 for D400 cameras on well-textured scenes."""
FARTHEST = 65.535
"""Farthest depth that is told [m]."""
STEEPEST = np.deg2rad(80.0)
"""Angle between view and normal from which a surface counts as steep [rad]."""
STEEP_LOSS = 0.5
"""Share of steep pixels without a reading."""
DARK = 12.0
"""Brightness below which readings get lost [of 255]."""


def measure(
    camera: CameraDescription,
    depth_mm: NDArray[np.uint16],
    rgb: NDArray[np.uint8],
    intrinsics: NDArray[np.float64],
    nearest: float,
    rng: np.random.Generator,
) -> NDArray[np.uint16]:
    """Return what a stereo camera would measure of one picture [mm], shape (H, W), 0 where it has no reading.

    Args:
        camera: Its figures.
        depth_mm: The true depth [mm], shape (H, W), 0 where nothing is.
        rgb: The colours there, shape (H, W, 3).
        intrinsics: Camera matrix [px], shape (3, 3).
        nearest: Nearest depth with a reading [m].
        rng: Draws the errors.
    """
    shape = depth_mm.shape
    focal, middle = np.float32(intrinsics[0, 0]), np.float32(intrinsics[0, 2])
    depth = np.float32(1e-3) * depth_mm
    is_seen = depth_mm > 0
    # What is nowhere is as far as can be told.
    disparity = focal * np.float32(camera.stereo_baseline) / np.where(is_seen, depth, np.float32(FARTHEST))
    is_lost = hidden_from_right(disparity)
    if camera.stereo_fovx:
        in_right = np.arange(shape[1], dtype=np.float32) - disparity
        is_lost |= in_right - middle < -focal * np.tan(np.float32(0.5 * camera.stereo_fovx))
    chance = rng.random(shape, dtype=np.float32)
    is_lost |= (chance < np.float32(STEEP_LOSS)) & is_steep(depth, float(focal))
    brightness = np.maximum(np.maximum(rgb[..., 0], rgb[..., 1]), rgb[..., 2])
    is_lost |= brightness < np.float32(DARK) * chance
    error = np.float32(SUBPIXEL) * rng.standard_normal(shape, dtype=np.float32)
    measured = depth + depth * error / disparity
    is_valid = is_seen & ~is_lost & (measured >= np.float32(nearest)) & (measured <= np.float32(FARTHEST))
    return np.where(is_valid, np.float32(1e3) * measured + np.float32(0.5), np.float32(0)).astype(np.uint16)


def hidden_from_right(disparity: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return which pixels of the left eye's picture the right eye does not see, as something nearer is before them.

    Args:
        disparity: Columns by which the right eye sees things farther to the left, shape (H, W) [px].
    """
    rows, width = disparity.shape
    in_right = np.arange(width, dtype=np.float32) - disparity
    # What is farther out than a picture's width is in neither picture.
    column = np.clip(in_right, -width, width - 1).astype(np.intp) + width
    place = column + np.arange(rows)[:, None] * (2 * width + 1)
    nearest = np.zeros(rows * (2 * width + 1), np.float32)
    for shift in (0, 1):  # a surface has no gaps where its pixels are more than a column apart
        np.maximum.at(nearest[shift:], place.reshape(-1), disparity.reshape(-1))
    # Neighbours on one surface differ by less than a pixel, or the right eye does not see it.
    return nearest[place] > disparity + np.float32(1.0)


def is_steep(depth: NDArray[np.float32], focal: float) -> NDArray[np.bool_]:
    """Return which pixels are beside an edge or on a surface that is seen at a grazing angle.

    Args:
        depth: [m], shape (H, W).
        focal: Focal length [px].
    """
    allowed = depth * np.float32(np.tan(STEEPEST) / focal)
    steep = np.zeros(depth.shape, np.bool_)
    for axis in (0, 1):
        first, second = (np.s_[:-1], np.s_[1:]) if axis == 0 else (np.s_[:, :-1], np.s_[:, 1:])
        step = np.abs(depth[second] - depth[first]) > np.minimum(allowed[first], allowed[second])
        steep[first] |= step
        steep[second] |= step
    return steep
