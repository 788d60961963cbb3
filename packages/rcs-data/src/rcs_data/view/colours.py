"""Numbers as colours, from dark to light, so that they read without a scale too."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# From dark blue over teal and green to a light yellow: lightness rises all the way.
_ANCHORS = np.array(
    [(18, 20, 66), (26, 70, 128), (20, 121, 138), (40, 164, 112), (142, 202, 74), (250, 240, 130)], np.float64
)
_PLACES = np.linspace(0, 255, len(_ANCHORS))
_TABLE = np.stack([np.interp(np.arange(256), _PLACES, channel) for channel in _ANCHORS.T], axis=1).astype(np.uint8)
# What was not measured is darker than any value.
_NOTHING = np.zeros(3, np.uint8)


def coloured(values: NDArray[Any], limits: tuple[float, float]) -> NDArray[np.uint8]:
    """Return the colours of numbers (H, W), shape (H, W, 3); black where there is none: NaN and, in integers, 0.

    The limits are the values of the darkest and the lightest colour.
    """
    low, high = limits
    is_known = np.isfinite(values) if values.dtype.kind == "f" else values != 0
    places = (np.nan_to_num(values.astype(np.float32), posinf=0.0, neginf=0.0) - low) * (255 / (high - low))
    colours = _TABLE[np.clip(places, 0, 255).astype(np.uint8)]
    return np.where(is_known[..., None], colours, _NOTHING)
