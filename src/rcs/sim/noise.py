"""Noise of cameras: of colour sensors here, and of stereo depth in `stereo`.

The noise of a frame depends only on the camera, the time and the positions of all joints: every frame has its own, and
the same seed gives the same frames in any copy and in every replay.
"""

from __future__ import annotations

import hashlib
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.robots.description import CameraDescription
from rcs.sim import stereo

COLOUR_DEVIATION = 2.0
"""Standard deviation of a colour value [of 255]: a small sensor in indoor light."""

# The noise of a random byte: drawing bytes takes a tenth of the time of normal numbers.
_COLOUR_NOISE = np.array(
    [round(NormalDist(0.0, COLOUR_DEVIATION).inv_cdf((i + 0.5) / 256)) for i in range(256)], np.int16
)


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
        noisy = {**frame, "rgb": np.empty_like(frame["rgb"])}
        if "depth" in frame:
            noisy["depth"] = np.empty_like(frame["depth"])
        for index in np.ndindex(moment.shape[:-1]):  # single frames have no leading axis
            rng = self._generator(moment[index])
            rgb = frame["rgb"][index]
            error = _COLOUR_NOISE[np.frombuffer(rng.bytes(rgb.size), np.uint8)].reshape(rgb.shape)
            error += rgb
            noisy["rgb"][index] = np.clip(error, 0, 255, out=error)
            if "depth" in frame:
                noisy["depth"][index] = stereo.measure(
                    self._camera, frame["depth"][index], rgb, frame["intrinsics"][index], self._nearest, rng
                )
        return noisy

    def _generator(self, moment: NDArray[np.float64]) -> np.random.Generator:
        digest = hashlib.blake2b(np.ascontiguousarray(moment).tobytes(), digest_size=16).digest()
        return np.random.Generator(np.random.SFC64([int.from_bytes(digest, "little"), self._number]))


def nearest_depth(camera: CameraDescription, size: tuple[int, int]) -> float:
    """Return the nearest measurable depth in frames of a size [m], that of the next larger format."""
    around = [entry for entry in sorted(camera.min_depth) if entry[0] >= size[0] and entry[1] >= size[1]]
    formats = around[:1] or sorted(camera.min_depth)[-1:]
    return formats[0][2] if formats else 0.0
