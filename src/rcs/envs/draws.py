"""Random numbers for the starts of episodes: the same for one environment and for any copy of a batch.

Every copy has a seed and counts its episodes; the numbers of an episode depend on these two alone. They come from
SplitMix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators", 2014), computed for all copies at
once.
"""

from __future__ import annotations

import copy
import zlib

import numpy as np
from numpy.typing import ArrayLike, NDArray

SEED_LIMIT = 2**63
"""Seeds are from 0 to below this: what an int64 holds."""

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_M1 = np.uint64(0xBF58476D1CE4E5B9)
_M2 = np.uint64(0x94D049BB133111EB)


def mix(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return SplitMix64's output function of each value."""
    z = values
    z = (z ^ (z >> np.uint64(30))) * _M1
    z = (z ^ (z >> np.uint64(27))) * _M2
    return z ^ (z >> np.uint64(31))


class Draws:
    """Streams of random numbers, one per copy that starts an episode."""

    def __init__(self, seeds: ArrayLike, episodes: ArrayLike) -> None:
        """Start the streams of some episodes.

        Args:
            seeds: Seed of each copy, any shape.
            episodes: Number of the episode since the seed was set, same shape.
        """
        with np.errstate(over="ignore"):
            seed = np.asarray(seeds).astype(np.uint64)
            episode = np.asarray(episodes).astype(np.uint64)
            self._state = mix(mix(seed + _GAMMA) + episode * _GAMMA + _GAMMA)
        self._start = self._state
        self.leading = self._state.shape
        """Leading shape of every draw."""

    def branch(self, name: str) -> Draws:
        """Return streams of their own for the same episodes; these here go on as if nothing was drawn from them.

        Args:
            name: Other name, other streams.
        """
        own = copy.copy(self)
        with np.errstate(over="ignore"):
            own._start = own._state = mix(self._start ^ mix(np.array(zlib.crc32(name.encode()), np.uint64) + _GAMMA))
        return own

    def uniform(self, low: ArrayLike, high: ArrayLike) -> NDArray[np.float64]:
        """Return numbers from [low, high), of shape (*leading, *shape of the bounds)."""
        lower, upper = np.broadcast_arrays(np.asarray(low, np.float64), np.asarray(high, np.float64))
        units = np.empty((*self.leading, lower.size))
        with np.errstate(over="ignore"):
            for i in range(lower.size):  # over dimensions, never over copies
                self._state = self._state + _GAMMA
                units[..., i] = (mix(self._state) >> np.uint64(11)) * 2.0**-53
        return lower + (upper - lower) * units.reshape(self.leading + lower.shape)
