"""Scales images smoothly, with the same result on every machine bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup

# Weights are multiples of 1/4096 and intermediate values multiples of 1/16: every sum is then a whole number below
# 2^24, exact in float32, so neither the order of summation nor the number of threads changes a bit.
_WEIGHT, _BETWEEN = 4096, 16


class Scaler:
    """Scales colour images from one size to another; each pixel is a mean weighted by a triangle.

    This is bilinear interpolation with a triangle that widens as the image shrinks, which avoids flicker.
    """

    def __init__(self, source: tuple[int, int], target: tuple[int, int]) -> None:
        """Prepare the weights.

        Args:
            source: Height and width of the input [px].
            target: Height and width of the output [px].

        Raises:
            InvalidSetup: A size is smaller than one pixel.
        """
        if min(*source, *target) < 1:
            raise InvalidSetup(
                f"Images cannot be scaled from {source} to {target}; sizes are (height, width), at least 1."
            )
        self.source, self.target = source, target
        self._rows, self._columns = (_weights(a, b) for a, b in zip(source, target, strict=True))

    def __call__(self, image: NDArray[Any], out: NDArray[np.uint8]) -> None:
        """Scale one image.

        Args:
            image: Shape (*source, channels), uint8.
            out: Where it goes, shape (*target, channels).
        """
        if self.source == self.target:
            out[...] = image
            return
        (height, width), (rows, columns) = self.source, self.target
        lines = self._rows @ image.reshape(height, -1).astype(np.float32)
        np.rint(lines * np.float32(_BETWEEN / _WEIGHT), out=lines)
        turned = lines.reshape(rows, width, -1).transpose(1, 0, 2).reshape(width, -1)
        scaled = np.rint(self._columns @ turned * np.float32(1 / (_BETWEEN * _WEIGHT)))
        out[...] = scaled.reshape(columns, rows, -1).transpose(1, 0, 2)


def _weights(source: int, target: int) -> NDArray[np.float32]:
    """Return the weight of each old pixel of a line in each new one [1/4096], shape (target, source)."""
    ratio = source / target
    centres = (np.arange(target) + 0.5) * ratio - 0.5
    distance = np.abs(np.arange(source) - centres[:, None])
    triangle = np.maximum(0, 1 - distance / max(ratio, 1))
    weights = np.rint(triangle / triangle.sum(axis=1, keepdims=True) * _WEIGHT)
    # The rounding error goes to the largest weight, so that a plain surface keeps its colour.
    weights[np.arange(target), weights.argmax(axis=1)] += _WEIGHT - weights.sum(axis=1)
    return weights.astype(np.float32)
