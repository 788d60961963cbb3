"""Scales images smoothly, with the same result on every machine bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs_data.errors import InvalidSetup

# Weights are multiples of 1/4096 and intermediate values multiples of 1/16: every sum is then a whole number below
# 2^24, exact in float32, so neither the order of summation nor the number of threads changes a bit.
_WEIGHT, _BETWEEN = 4096, 16


def whole_size(size: object, name: str = "size") -> tuple[int, int]:
    """Return the width and height of images [px].

    Args:
        size: The two numbers, in any sequence.
        name: Their name, for the message.

    Raises:
        InvalidSetup: They are not two whole numbers.
    """
    given = tuple(size) if isinstance(size, tuple | list | np.ndarray) else ()
    if len(given) != 2 or not all(isinstance(n, int | np.integer) for n in given):
        raise InvalidSetup(f"{name} is {size!r:.80}; it must be width and height, two whole numbers [px].")
    return int(given[0]), int(given[1])


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
        self._rows, self._columns = (_taps(a, b) for a, b in zip(source, target, strict=True))

    def __call__(self, image: NDArray[Any], out: NDArray[np.uint8]) -> None:
        """Scale one image.

        Args:
            image: Shape (*source, channels), uint8.
            out: Where it goes, shape (*target, channels).
        """
        if self.source == self.target:
            out[...] = image
            return
        (_, width), (rows, _) = self.source, self.target
        lines = _sum(self._rows, image.reshape(len(image), -1))
        np.rint(lines * np.float32(_BETWEEN / _WEIGHT), out=lines)
        scaled = _sum(self._columns, lines.reshape(rows, width, -1).swapaxes(0, 1))
        out[...] = np.rint(scaled * np.float32(1 / (_BETWEEN * _WEIGHT))).swapaxes(0, 1)


Taps = list[tuple[NDArray[np.intp], NDArray[np.float32]]]
"""One more old pixel for every new pixel of a line, and its weight [1/4096]; both (target,)."""


def _sum(taps: Taps, pixels: NDArray[Any]) -> NDArray[np.float32]:
    """Return the weighted sums of pixels along the first axis; a product of matrices would sum mostly zeros."""
    shape = (-1, *[1] * (pixels.ndim - 1))
    total = np.zeros((), np.float32)
    for chosen, weights in taps:
        total = total + pixels[chosen] * weights.reshape(shape)
    return total


def _taps(source: int, target: int) -> Taps:
    """Return which pixels of a line are in each of the new one, and how much."""
    ratio = source / target
    centres = (np.arange(target) + 0.5) * ratio - 0.5
    distance = np.abs(np.arange(source) - centres[:, None])
    triangle = np.maximum(0, 1 - distance / max(ratio, 1))
    weights = np.rint(triangle / triangle.sum(axis=1, keepdims=True) * _WEIGHT)
    # The rounding error goes to the largest weight, so that a plain surface keeps its colour.
    weights[np.arange(target), weights.argmax(axis=1)] += _WEIGHT - weights.sum(axis=1)
    first, reach = (weights > 0).argmax(axis=1), int((weights > 0).sum(axis=1).max())
    padded = np.pad(weights, ((0, 0), (0, reach))).astype(np.float32)
    chosen = [first + tap for tap in range(reach)]
    return [(np.minimum(one, source - 1), padded[np.arange(target), one]) for one in chosen]
