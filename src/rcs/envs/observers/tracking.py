"""How well one arm follows another in time: the error of every joint, and the lag, over a sliding window.

Both are of joints over time: what is expected, on a grid of moments, and what is measured, at any moments. The lag is
the shift in time that makes the variance of their difference least (a constant difference, such as sag, is no lag),
refined by the parabola through the least value and its neighbours.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup

LEAST_MOTION = 0.01
"""A lag is found only where the expected joints have moved by this root mean square about their mean [rad]."""

LEAST_SAMPLES = 10
"""And from this many measurements on."""


class Tracking:
    """One arm's expected and measured joints, and what separates them."""

    def __init__(self, dof: int, *, grid: float, window: float = 2.0, longest_lag: float = 0.2) -> None:
        """Begin without a measurement.

        Args:
            dof: Number of joints.
            grid: Time between two expected values [s].
            window: Time that is looked back on [s].
            longest_lag: Longest lag that is looked for [s].

        Raises:
            InvalidSetup: A time is not positive, or the window is not longer than the lag.
        """
        if not 0 < grid < longest_lag < window:
            raise InvalidSetup(
                f"grid is {grid} s, longest_lag {longest_lag} s and window {window} s; valid is 0 < grid < longest_lag "
                "< window."
            )
        self.longest_lag = longest_lag
        """Longest lag that is looked for [s]."""
        self._grid = grid
        self._window = window
        self._shifts = np.arange(0.0, longest_lag + grid / 2, grid)
        self._kept = round((window + longest_lag) / grid) + 2
        self._expected = np.zeros((2 * self._kept, dof))
        self._measured: deque[tuple[float, NDArray[np.float64]]] = deque()
        self.start(0.0, np.zeros(dof))

    def start(self, time: float, joints: NDArray[np.float64]) -> None:
        """Forget everything; the arm has stood still until now.

        Args:
            time: The present moment [s].
            joints: The joints that are expected at it [rad], (dof,).
        """
        self._expected[0] = joints
        self._count = 1
        self._last = time
        self._measured.clear()
        self.lag: float | None = None
        """Time by which what is measured comes after what is expected [s]; None before there was enough motion."""

    def expect(self, time: float, joints: NDArray[np.float64]) -> None:
        """Add the joints [rad] that are expected one step of the grid after the last ones, which is `time` [s]."""
        if self._count == len(self._expected):
            self._expected[: self._kept] = self._expected[-self._kept :]
            self._count = self._kept
        self._expected[self._count] = joints
        self._count += 1
        self._last = time

    def measure(self, time: float, joints: NDArray[np.float64]) -> None:
        """Add a measurement [rad], (dof,), at a moment [s] that is not after what is expected."""
        self._measured.append((time, np.array(joints, np.float64)))
        while self._measured[0][0] < time - self._window:
            self._measured.popleft()

    def expected_at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the expected joints [rad], (*times.shape, dof), at moments [s], from those of the start on."""
        place = np.clip((times - self._last) / self._grid + self._count - 1, 0, self._count - 1)
        before = np.minimum(place.astype(np.int64), max(self._count - 2, 0))
        part = (place - before)[..., None]
        after = np.minimum(before + 1, self._count - 1)
        return self._expected[before] * (1.0 - part) + self._expected[after] * part

    def find_lag(self) -> float | None:
        """Look for the lag in the window, keep it as `lag`, and return it [s]; the former one without enough motion."""
        times, joints = self._samples()
        if len(times) < LEAST_SAMPLES:
            return self.lag
        expected = self.expected_at(times[None, :] - self._shifts[:, None])  # (shifts, samples, dof)
        if np.sqrt(expected[0].var(axis=0).sum()) < LEAST_MOTION:
            return self.lag
        costs = (expected - joints).var(axis=1).sum(axis=1)
        least = int(costs.argmin())
        offset = 0.0
        if 0 < least < len(costs) - 1:
            below, at, above = costs[least - 1 : least + 2]
            if (bend := below - 2 * at + above) > 0:
                offset = 0.5 * (below - above) / bend
        self.lag = float(self._shifts[least] + offset * self._grid)
        return self.lag

    def rms(self, lag: float = 0.0) -> NDArray[np.float64]:
        """Return the root mean square of every joint's error over the window [rad], (dof,), at a lag [s]."""
        times, joints = self._samples()
        if not len(times):
            return np.zeros(self._expected.shape[1])
        return np.sqrt(np.square(joints - self.expected_at(times - lag)).mean(axis=0))

    def deviation(self, earliest: float, latest: float) -> NDArray[np.float64]:
        """Return how far the last measurement is from the nearest point of the expected path, (dof,) [rad].

        The path is that between two lags [s], and nearest the point at which the worst joint is best.
        """
        time, joints = self._measured[-1]
        shifts = np.arange(max(earliest, 0.0), latest + self._grid / 2, self._grid)
        errors = np.abs(self.expected_at(time - shifts) - joints)
        return errors[errors.max(axis=1).argmin()]

    def _samples(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return np.array([time for time, _ in self._measured]), np.array([joints for _, joints in self._measured])
