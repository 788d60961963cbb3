"""The clock of a machine that may sleep, while which its clock stands still."""

from __future__ import annotations

import math

from rcs.errors import DeviceFault
from rcs.hardware.device_clock import DeviceClock

LATE = 5.0
"""Age of a moment from which on its packet may have been delayed by a sleep [s]; no network keeps as much back for
long."""
ALIKE = 0.1
"""Difference of delays up to which they are one [s]; after a stall of the network, they shrink."""
SURE = 3.0
"""Time after which such delays are a sleep's [s]."""


class WakingClock:
    """Maps times of a machine's clock to the host's, as `DeviceClock`, and begins anew after the machine has slept."""

    def __init__(self) -> None:
        self._begin()

    def _begin(self) -> None:
        self._clock = DeviceClock()
        self._since, self._late = math.inf, math.inf

    def host_time(self, device_time: float, arrived: float) -> float | None:
        """Return the host's time of a moment [s]; arguments as of `DeviceClock.host_time`.

        None if the clock has gone back, jumped ahead or stood still; the next moment is the first of another clock.
        """
        try:
            at = self._clock.host_time(device_time, arrived)
        except DeviceFault:
            self._begin()
            return None
        late = arrived - at
        if late < LATE:
            self._since = self._late = math.inf
        elif not abs(late - self._late) <= ALIKE:
            self._since, self._late = arrived, late
        elif arrived - self._since > SURE:
            self._begin()
            return None
        return at
