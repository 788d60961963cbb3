"""Noise of cameras: of colour sensors, and of stereo depth.

The noise of a frame depends only on the visible state, so the same seed gives the same frames in any copy.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.robots.description import CameraDescription

COLOUR_DEVIATION = 2.0
"""Standard deviation of a colour value [of 255]: a small sensor in indoor light."""
SUBPIXEL = 0.08
"""Standard deviation of a disparity [px], as Intel states for D400 cameras on textured scenes."""
EDGE = 64
"""Margin of a noise field over a frame, which allows to shift it [px]."""


class CameraNoise:
    """Noise of one camera, added to rendered frames."""

    def __init__(self, camera: CameraDescription, size: tuple[int, int], number: int) -> None:
        """Prepare fields of noise.

        Args:
            camera: Its figures.
            size: Width and height of frames [px].
            number: Number of the camera in its scene, as each has different noise.
        """
        width, height = size
        rng = np.random.default_rng(number)
        shape = (height + EDGE, width + EDGE)
        self._colour = np.rint(rng.normal(0.0, COLOUR_DEVIATION, (*shape, 3))).astype(np.int16)
        self._disparity = rng.normal(0.0, SUBPIXEL, shape)
        self._baseline = camera.stereo_baseline
        self._nearest = nearest_depth(camera, size)

    def add(self, frame: dict[str, NDArray[Any]], state: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
        """Return a frame with noise.

        Args:
            frame: `rgb` (*leading, H, W, 3), `intrinsics` (*leading, 3, 3) and perhaps `depth` [mm] (*leading, H, W).
            state: Positions of all joints, (*leading, nq); determines the part of the noise field.
        """
        leading = state.shape[:-1]
        noisy = {key: value.copy() for key, value in frame.items()}
        for index in np.ndindex(leading):  # single frames have no leading axis
            row, column = _shift(state[index])
            height, width = frame["rgb"][index].shape[:2]
            part = np.s_[row : row + height, column : column + width]
            noisy["rgb"][index] = np.clip(frame["rgb"][index] + self._colour[part], 0, 255)
            if "depth" in frame:
                focal = float(frame["intrinsics"][index][0, 0])
                noisy["depth"][index] = self._depth(frame["depth"][index], focal, self._disparity[part])
        return noisy

    def _depth(self, depth_mm: NDArray[np.uint16], focal: float, disparity: NDArray[np.float64]) -> NDArray[np.uint16]:
        """Return depth with the error of a disparity, dz = z^2 / (f b) dd, and without readings that are too near."""
        depth = 1e-3 * depth_mm
        measured = depth + depth * depth / (focal * self._baseline) * disparity
        is_seen = (depth_mm > 0) & (measured >= self._nearest)
        return np.where(is_seen, np.clip(np.rint(1e3 * measured), 0, 65535), 0).astype(np.uint16)


def nearest_depth(camera: CameraDescription, size: tuple[int, int]) -> float:
    """Return the nearest measurable depth in frames of a size [m], that of the next larger format."""
    around = [entry for entry in sorted(camera.min_depth) if entry[0] >= size[0] and entry[1] >= size[1]]
    formats = around[:1] or sorted(camera.min_depth)[-1:]
    return formats[0][2] if formats else 0.0


def _shift(state: NDArray[np.float64]) -> tuple[int, int]:
    """Return the offset of a state's noise in its field, a hash of the state's bits."""
    bits = np.ascontiguousarray(state).view(np.uint64)
    with np.errstate(over="ignore"):
        weights = np.arange(1, len(bits) + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        mixed = int(np.bitwise_xor.reduce(bits * (weights | np.uint64(1))))
    return (mixed >> 20) % EDGE, (mixed >> 40) % EDGE
