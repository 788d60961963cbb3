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

from functools import cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from rcs._core import measure_stereo
from rcs.robots.description import CameraDescription

SUBPIXEL = 0.08
"""Standard deviation of a disparity [px]; Intel states 0.05 to 0.1 for D400 cameras on well-textured scenes."""
STEEPEST = np.deg2rad(80.0)
"""Angle between view and normal from which a surface counts as steep [rad]."""
STEEP_LOSS = 0.5
"""Share of steep pixels without a reading."""
DARK = 12.0
"""Brightness below which readings get lost [of 255]."""

_QUANTILES = 4096


def measure(
    camera: CameraDescription,
    depth_mm: NDArray[np.uint16],
    rgb: NDArray[np.uint8],
    intrinsics: NDArray[np.float64],
    nearest: float,
    seed: int,
) -> None:
    """Replace the depth of one picture by what a stereo camera would measure, in place; 0 is no reading.

    Args:
        camera: Its figures.
        depth_mm: The true depth [mm], shape (H, W), 0 where nothing is.
        rgb: The colours there, shape (H, W, 3).
        intrinsics: Camera matrix [px], shape (3, 3).
        nearest: Nearest depth with a reading [m].
        seed: Determines the errors.
    """
    measure_stereo(
        depth_mm,
        rgb,
        focal=float(intrinsics[0, 0]),
        middle=float(intrinsics[0, 2]),
        baseline=camera.stereo_baseline,
        half_width=float(np.tan(0.5 * camera.stereo_fovx)),
        nearest=nearest,
        deviation=SUBPIXEL,
        steepest=float(np.tan(STEEPEST)),
        steep_loss=STEEP_LOSS,
        dark=DARK,
        normal=_normal(),
        seed=seed,
    )


@cache
def _normal() -> NDArray[np.float32]:
    """Return quantiles of the standard normal distribution: drawing from them needs no logarithm."""
    quantile = NormalDist().inv_cdf
    return np.array([quantile((i + 0.5) / _QUANTILES) for i in range(_QUANTILES)], np.float32)
