"""The clock of a device, mapped to the host's by a fit over the session.

A packet arrives some time after the moment that it carries, never before. The fit is therefore the highest straight
line under all pairs of device time and arrival: packets that were delayed lie above it and do not move it.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from rcs.errors import DeviceFault

WINDOW = 1.0
"""The fastest packet of this span enters the fit [s]."""
MEMORY = 300
"""Number of windows that the fit covers: drift changes with temperature over longer times."""
MOST_DRIFT = 200e-6
"""Largest drift of a quartz with some margin [1]."""
SLACK = 1e-3
"""By how much the fastest packet of a window may be later than the fit before it counts as delayed [s]."""
SOONER = 2e-3
"""By how much a packet must be sooner than the fit to prove that all packets before it were delayed [s]."""
SURE_AFTER = 3
"""Number of windows from which a jump can be told from a late beginning."""
JUMP = 0.25
"""By how much a packet must be sooner than the fit to prove that the device's clock has jumped [s]."""


class DeviceClock:
    """Maps times of one device's clock to the host's monotonic clock."""

    def __init__(self, latency: float = 0.0) -> None:
        """Know nothing yet.

        Args:
            latency: Time from a moment to the arrival of its fastest packet [s], which no fit can find.
        """
        self.drift = 0.0
        """How much slower the device's clock is than the host's, as a fraction."""
        self.steady = 0
        """Number of packets since the last one that proved those before it late."""
        self._latency = latency
        self._offset = math.nan
        self._begin, self._begin_offset = math.nan, 0.0
        self._last = (-math.inf, -math.inf)
        self._windows: deque[tuple[float, float]] = deque(maxlen=MEMORY)
        self._opened = -math.inf
        self._fastest: tuple[float, float] | None = None

    @property
    def offset(self) -> float:
        """Offset to add to the newest device time for the host's monotonic time [s]; NaN before the first."""
        return self._begin_offset + self._line(self._last[0] - self._begin)

    def host_time(self, device_time: float, arrived: float) -> float:
        """Return the host's time of a moment of the device.

        Args:
            device_time: The moment on the device's clock [s]; later moments come later.
            arrived: When its packet arrived [s, monotonic clock of the host].

        Returns:
            The moment [s, monotonic clock of the host], later than that of any earlier one, and not after `arrived`.

        Raises:
            DeviceFault: The device's clock has gone back or jumped ahead.
        """
        if device_time == self._last[0]:
            return self._last[1]
        if not device_time > self._last[0]:
            raise DeviceFault(f"the device's clock went from {self._last[0]:.3f} s back to {device_time:.3f} s")
        if math.isnan(self._begin):
            self._begin, self._begin_offset = device_time, arrived - device_time
        at = device_time - self._begin
        behind = arrived - device_time - self._begin_offset  # of the device's clock, delay included
        # At first, all packets may have been late: that shows in the first that is not, and is no jump.
        if len(self._windows) >= SURE_AFTER and behind < self._line(at) - JUMP:
            raise DeviceFault(f"the device's clock has jumped ahead by {self._line(at) - behind:.3f} s")
        self._learn(at, behind)
        mapped = device_time + self._begin_offset + self._line(at) - self._latency
        mapped = min(max(mapped, self._last[1] + 1e-6), arrived)
        self._last = (device_time, mapped)
        return mapped

    def _line(self, at: float) -> float:
        return self._offset + self.drift * at

    def _learn(self, at: float, behind: float) -> None:
        """Take a packet into the fit, unless it was delayed."""
        is_known = math.isfinite(self._offset)
        self.steady += 1
        if is_known and behind < self._line(at) - SOONER:
            self._windows.clear()
            self._fastest = None
            self.steady = 0
        if self._fastest is None:
            self._opened, self._fastest = at, (at, behind)
        elif at - self._opened < WINDOW:
            self._fastest = min(self._fastest, (at, behind), key=lambda pair: pair[1])
        else:
            newest = self._windows[-1][0] if self._windows else self._fastest[0]
            late = SLACK + 0.5 * MOST_DRIFT * (self._fastest[0] - newest)
            if len(self._windows) < 3 or self._fastest[1] <= self._line(self._fastest[0]) + late:
                self._windows.append(self._fastest)
                self._fit()
            self._opened, self._fastest = at, (at, behind)
        if not is_known or behind < self._line(at):
            self._fit((at, behind))

    def _fit(self, extra: tuple[float, float] | None = None) -> None:
        points = np.array([*self._windows, *([] if extra is None else [extra])])
        x, y = points[:, 0], points[:, 1]
        if len(x) > 2 and extra is None:
            self.drift = float(np.clip(_support(x, y), -MOST_DRIFT, MOST_DRIFT))
        self._offset = float((y - self.drift * x).min())


def _support(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """Return the slope of the edge of the points' lower hull that lies over their mean: the highest line below all."""
    hull: list[int] = []
    for i in range(len(x)):
        while len(hull) > 1:
            a, b = hull[-2], hull[-1]
            if (y[b] - y[a]) * (x[i] - x[a]) < (y[i] - y[a]) * (x[b] - x[a]):
                break
            hull.pop()
        hull.append(i)
    middle = x.mean()
    a = max((j for j in range(len(hull) - 1) if x[hull[j]] <= middle), default=0)
    return float((y[hull[a + 1]] - y[hull[a]]) / (x[hull[a + 1]] - x[hull[a]]))
