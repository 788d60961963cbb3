"""Noise of cameras: errors of colour sensors and of stereo depth.

The noise of a frame depends only on the camera's name, the time and the positions of all joints: every frame has its
own, and the same seed gives the same frames in any copy and in every replay, whichever other cameras are observed.

Depth has the errors of the RealSense D400 series; 0 is no reading, as on the device:

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

import hashlib
from functools import cache
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs._core import add_colour_noise, measure_stereo
from rcs.robots.camera import CameraDescription

COLOUR_DEVIATION = 2.0
"""Standard deviation of a colour value [of 255]: a small sensor in indoor light."""

SUBPIXEL = 0.08
"""Standard deviation of a disparity [px]; Intel states 0.05 to 0.1 for D400 cameras on well-textured scenes."""
STEEPEST = np.deg2rad(80.0)
"""Angle between view and normal from which a surface counts as steep [rad]."""
STEEP_LOSS = 0.5
"""Share of steep pixels without a reading."""
DARK = 12.0
"""Brightness below which readings get lost [of 255]."""

_QUANTILES = 4096
_DEPTH_BRANCH = 0x5DEECE66D
# Separates the errors of depth from those of colours.


class CameraNoise:
    """Noise of one camera, added to rendered frames."""

    def __init__(self, camera: CameraDescription, size: tuple[int, int], name: str) -> None:
        """Prepare the noise.

        Args:
            camera: The camera's figures.
            size: Width and height of frames [px].
            name: Name of the camera in its scene; each name has different noise.
        """
        self._camera = camera
        self._name = name.encode()
        self._nearest = nearest_depth(camera, size)

    def add(self, frame: dict[str, NDArray[Any]], moment: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
        """Return a frame with noise.

        Args:
            frame: `rgb` (*leading, H, W, 3), `intrinsics` (*leading, 3, 3) and perhaps `depth` [mm] (*leading, H, W).
            moment: Time and positions of all joints, (*leading, 1 + nq); determines the noise.
        """
        noisy = {key: values.copy() if key in ("rgb", "depth") else values for key, values in frame.items()}
        for index in np.ndindex(moment.shape[:-1]):  # single frames have no leading axis
            seed = self._seed(moment[index])
            if "depth" in frame:
                true_colours, matrix = frame["rgb"][index], frame["intrinsics"][index]
                self.measure_depth(noisy["depth"][index], true_colours, matrix, seed ^ _DEPTH_BRANCH)
            add_colour_noise(noisy["rgb"][index], _colour_errors(), seed)
        return noisy

    def measure_depth(
        self, depth_mm: NDArray[np.uint16], rgb: NDArray[np.uint8], intrinsics: NDArray[np.float64], seed: int
    ) -> None:
        """Replace the depth of one picture by that of a stereo camera, in place; 0 is no reading.

        Args:
            depth_mm: The true depth [mm], shape (H, W), 0 for no surface.
            rgb: The colours there, shape (H, W, 3).
            intrinsics: Camera matrix [px], shape (3, 3).
            seed: Determines the errors.
        """
        measure_stereo(
            depth_mm,
            rgb,
            focal=float(intrinsics[0, 0]),
            middle=float(intrinsics[0, 2]),
            baseline=self._camera.stereo_baseline,
            half_width=float(np.tan(0.5 * self._camera.stereo_fovx)),
            nearest=self._nearest,
            deviation=SUBPIXEL,
            steepest=float(np.tan(STEEPEST)),
            steep_loss=STEEP_LOSS,
            dark=DARK,
            normal=_normal(),
            seed=seed,
        )

    def _seed(self, moment: NDArray[np.float64]) -> int:
        """Return 64 bits that are others for any other moment or camera."""
        bits = np.ascontiguousarray(moment).tobytes() + self._name
        return int.from_bytes(hashlib.blake2b(bits, digest_size=8).digest(), "little")


@cache
def _colour_errors() -> NDArray[np.int8]:
    """Return the errors of 256 equally likely cases."""
    quantile = NormalDist(0.0, COLOUR_DEVIATION).inv_cdf
    return np.array([round(quantile((i + 0.5) / 256)) for i in range(256)], np.int8)


def nearest_depth(camera: CameraDescription, size: tuple[int, int]) -> float:
    """Return the nearest measurable depth in frames of a size [m], that of the next larger format."""
    around = [entry for entry in sorted(camera.min_depth) if entry[0] >= size[0] and entry[1] >= size[1]]
    formats = around[:1] or sorted(camera.min_depth)[-1:]
    return formats[0][2] if formats else 0.0


@cache
def _normal() -> NDArray[np.float32]:
    """Return quantiles of the standard normal distribution: drawing from them needs no logarithm."""
    quantile = NormalDist().inv_cdf
    return np.array([quantile((i + 0.5) / _QUANTILES) for i in range(_QUANTILES)], np.float32)
