"""The filter of a hand's pose: calm while the hand is still, quick while it moves.

It is the One-Euro filter of Casiez, Roussel and Vogel (CHI 2012), evaluated at the moments of the loop instead of those
of the samples, so that a loop that is faster than the device has a new target in every step.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rcs.spatial import distance, interpolate

SPEED_CUTOFF = 5.0
"""Cutoff frequency of the measured speed [Hz]."""

TURN = 0.2
"""Speed of translation that counts as much as a rotational speed of one [m/rad]."""


class PoseFilter:
    """Follows samples of a pose with a low-pass whose cutoff frequency grows with their speed."""

    def __init__(self, cutoff: float, quickness: float) -> None:
        """Set the cutoff.

        Args:
            cutoff: Cutoff frequency at rest [Hz].
            quickness: Its increase with the speed [Hz per m/s].
        """
        self._cutoff, self._quickness = cutoff, quickness
        self._newest = self._filtered = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        self._sampled = self._now = 0.0
        self._speeds = np.zeros(2)

    def reset(self, pose: NDArray[np.float64], time: float, now: float) -> None:
        """Start at rest at a pose, (7,), that was sampled at a moment [s]."""
        self._newest = self._filtered = np.array(pose, np.float64)
        self._sampled, self._now = time, now
        self._speeds = np.zeros(2)

    def take(self, pose: NDArray[np.float64], time: float) -> None:
        """Take a sample, (7,), of a moment [s]; an old one again changes nothing."""
        passed = time - self._sampled
        if passed <= 0:
            return
        speeds = np.asarray(distance(self._newest, pose)) / passed
        self._speeds = self._speeds + (speeds - self._speeds) * _share(SPEED_CUTOFF, passed)
        self._newest, self._sampled = np.array(pose, np.float64), time

    def at(self, now: float) -> NDArray[np.float64]:
        """Return the filtered pose, (7,), at a moment [s]."""
        passed, self._now = max(now - self._now, 0.0), now
        way, turn = self._speeds
        shares = [_share(self._cutoff + self._quickness * speed, passed) for speed in (way, TURN * turn)]
        filtered = interpolate(self._filtered, self._newest, shares[1])
        filtered[:3] = self._filtered[:3] + shares[0] * (self._newest[:3] - self._filtered[:3])
        self._filtered = filtered
        return filtered


def _share(cutoff: float, passed: float) -> float:
    """Return the share of the way to its input that a low-pass goes in some time [s]."""
    return 1.0 - math.exp(-2.0 * math.pi * cutoff * passed)
