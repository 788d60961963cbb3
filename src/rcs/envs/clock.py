"""What lets time pass, once per step, for all devices together."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from rcs._core import StepEnd
from rcs.envs.ports import Port
from rcs.errors import InvalidSetup
from rcs.sim.world import Copies, World

FAULT_POLL = 5e-3
"""How often a clock that waits asks the devices for faults [s]."""


ROUNDING = 1e-9
"""Nobody waits for less than this [s]."""


class Clock(ABC):
    """Advances everything by one control step."""

    @abstractmethod
    def advance(self, copies: Copies = None) -> None:
        """Let one control step pass."""

    @abstractmethod
    def reset(self) -> None:
        """Start an episode now."""

    @property
    @abstractmethod
    def ends(self) -> NDArray[np.uint8]:
        """Why the last step ended, `StepEnd` values per copy."""


class SimClock(Clock):
    """Steps a world; in real time it then waits until the wall clock has caught up."""

    def __init__(self, world: World) -> None:
        """Use the world's mode and frequency."""
        self._world = world
        self._is_realtime = world.mode == "realtime"
        self._start = 0.0
        self._steps = 0
        self._ends: NDArray[np.uint8] = world.core.ends

    def advance(self, copies: Copies = None) -> None:
        """Step the world."""
        self._world.advance(copies)
        if self._is_realtime:
            self._steps += 1
            rest = self._start + self._steps * self._world.period - time.perf_counter()
            if rest > 0:
                time.sleep(rest)
            else:
                # Late: the missed time is not caught up, which would be faster than real time.
                self._start -= rest

    def reset(self) -> None:
        """Count time from now."""
        self._start = time.perf_counter()
        self._steps = 0

    @property
    def ends(self) -> NDArray[np.uint8]:
        """Why the last step ended, per copy."""
        return self._ends


class WallClock(Clock):
    """Waits for real devices: until they have arrived, or for one control period.

    A device that enters its fault state ends the wait at once; the environment sees the fault and ends the episode.
    """

    def __init__(
        self,
        ports: Sequence[Port],
        *,
        frequency: float = 30.0,
        is_synchronous: bool = False,
        time_limit: float = 10.0,
        now: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Keep the rate of a loop.

        Args:
            ports: Devices that a synchronous step waits for.
            frequency: Control steps per second [Hz].
            is_synchronous: Wait for the devices instead of for a period.
            time_limit: Longest synchronous step [s].
            now: Monotonic time [s].
            sleep: Waits for some seconds.

        Raises:
            InvalidSetup: A frequency or time limit that is not positive.
        """
        if not frequency > 0 or not time_limit > 0:
            raise InvalidSetup(f"frequency ({frequency}) and time_limit ({time_limit}) must be positive.")
        self._ports = list(ports)
        self._fallible = [port for port in ports if type(port).faults is not Port.faults]
        self._period = 1.0 / frequency
        self._is_synchronous = is_synchronous
        self._time_limit = time_limit
        self._now = now
        self._sleep = sleep
        self._next = now()
        self._ends = np.zeros(1, np.uint8)

    def advance(self, copies: Copies = None) -> None:
        """Wait."""
        self._ends[0] = self._wait_for_devices() if self._is_synchronous else self._wait_for_tick()

    def _wait_for_tick(self) -> int:
        self._next += self._period
        rest = self._next - self._now()
        if rest <= 0:
            self._next = self._now()  # late: later steps keep their full period
        while rest > ROUNDING and not self._has_fault():
            self._sleep(min(rest, FAULT_POLL) if self._fallible else rest)
            rest = self._next - self._now()
        return StepEnd.period.value

    def _has_fault(self) -> bool:
        return any(port.faults() for port in self._fallible)

    def _wait_for_devices(self) -> int:
        deadline = self._now() + self._time_limit
        while not all(port.has_arrived() for port in self._ports):
            if self._has_fault():
                return StepEnd.interrupted.value
            if self._now() >= deadline:
                return StepEnd.limit.value
            self._sleep(1e-3)
        return StepEnd.converged.value

    def reset(self) -> None:
        """Count time from now."""
        self._next = self._now()

    @property
    def ends(self) -> NDArray[np.uint8]:
        """Why the last step ended."""
        return self._ends
