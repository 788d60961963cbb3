"""Random numbers for episodes, the same for one environment and for any copy of a batch.

Every copy has a seed and counts its episodes; an episode's numbers depend only on these two. They come from
SplitMix64, computed for all copies at once.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs.errors import InvalidSetup
from rcs.sim.splitmix import GAMMA, branch, mix, units

SEED_LIMIT = 2**63
"""Seeds are from 0 to below this, the range of int64."""


def check_seed(seed: Any) -> int:
    """Return a seed as Python's own integer.

    Raises:
        InvalidSetup: It is not a whole number from 0 to 2**63 - 1.
    """
    if not isinstance(seed, int | np.integer) or isinstance(seed, bool) or not 0 <= seed < SEED_LIMIT:
        raise InvalidSetup(f"The seed is {seed!r}; valid is a whole number from 0 to 2**63 - 1.")
    return int(seed)


class EpisodeRandom:
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
            self._state = mix(mix(seed + GAMMA) + episode * GAMMA + GAMMA)
        self._start = self._state
        self.leading = self._state.shape
        """Leading shape of every draw."""

    def branch(self, name: str) -> EpisodeRandom:
        """Return independent streams for the same episodes, without advancing these.

        Args:
            name: Name of the streams; different names give different numbers.
        """
        own = copy.copy(self)
        own._start = own._state = branch(self._start, name)
        return own

    def uniform(self, low: ArrayLike, high: ArrayLike) -> NDArray[np.float64]:
        """Return numbers from [low, high), of shape (*leading, *shape of the bounds)."""
        lower, upper = np.broadcast_arrays(np.asarray(low, np.float64), np.asarray(high, np.float64))
        with np.errstate(over="ignore"):
            states = self._state[..., None] + np.arange(1, lower.size + 1, dtype=np.uint64) * GAMMA
            drawn = units(mix(states))
            self._state = self._state + np.uint64(lower.size) * GAMMA
        return lower + (upper - lower) * drawn.reshape(self.leading + lower.shape)

    def bits(self) -> NDArray[np.uint64]:
        """Return 64 random bits for each copy, such as a key for other streams, (*leading,)."""
        with np.errstate(over="ignore"):
            self._state = self._state + GAMMA
            return mix(self._state)
