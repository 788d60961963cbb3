"""Noise of cameras: of colour sensors here, and of stereo depth in `stereo`.

The noise of a frame depends only on the camera, the time and the positions of all joints: every frame has its own, and
the same seed gives the same frames in any copy and in every replay.
"""

from __future__ import annotations

import hashlib
from functools import cache
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs._core import add_colour_noise
from rcs.robots.description import CameraDescription
from rcs.sim import stereo

COLOUR_DEVIATION = 2.0
"""Standard deviation of a colour value [of 255]: a small sensor in indoor light."""

_DEPTH_BRANCH = 0x5DEECE66D
# Tells the errors of depth from those of colours.


class CameraNoise:
    """Noise of one camera, added to rendered frames."""

    def __init__(self, camera: CameraDescription, size: tuple[int, int], number: int) -> None:
        """Prepare the noise.

        Args:
            camera: Its figures.
            size: Width and height of frames [px].
            number: Number of the camera in its scene, as each has different noise.
        """
        self._camera = camera
        self._number = number
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
                depth: NDArray[np.uint16] = noisy["depth"][index]
                stereo.measure(self._camera, depth, true_colours, matrix, self._nearest, seed ^ _DEPTH_BRANCH)
            add_colour_noise(noisy["rgb"][index], _colour_errors(), seed)
        return noisy

    def _seed(self, moment: NDArray[np.float64]) -> int:
        """Return 64 bits that are others for any other moment or camera."""
        bits = np.ascontiguousarray(moment).tobytes() + self._number.to_bytes(8, "little")
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
