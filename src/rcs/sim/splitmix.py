"""SplitMix64 as functions: random numbers that depend on a key and a counter alone, computed for whole arrays at once.

Steele, Lea, Flood, "Fast splittable pseudorandom number generators", 2014.
"""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

GAMMA = np.uint64(0x9E3779B97F4A7C15)
"""Factor of the counter: the golden ratio in 64 bits, made odd."""

_M1 = np.uint64(0xBF58476D1CE4E5B9)
_M2 = np.uint64(0x94D049BB133111EB)


def mix(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return SplitMix64's output function of each value."""
    z = values
    z = (z ^ (z >> np.uint64(30))) * _M1
    z = (z ^ (z >> np.uint64(27))) * _M2
    return z ^ (z >> np.uint64(31))


def units(bits: NDArray[np.uint64]) -> NDArray[np.float64]:
    """Return numbers from [0, 1) made of 53 random bits each."""
    return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53


def branch(keys: NDArray[np.uint64], name: str) -> NDArray[np.uint64]:
    """Return the keys of independent streams; different names give different streams."""
    with np.errstate(over="ignore"):
        return mix(keys ^ mix(np.array(zlib.crc32(name.encode()), np.uint64) + GAMMA))


def numbered(keys: NDArray[np.uint64], numbers: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the random numbers of streams, from [0, 1), that have certain places in them."""
    with np.errstate(over="ignore"):
        return units(mix(keys + numbers.astype(np.uint64) * GAMMA))
