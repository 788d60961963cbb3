"""The clock, which lets time pass once per step for all devices together."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rcs._core import StepEnd
from rcs.envs.ports.port import Port
from rcs.errors import InvalidSetup
from rcs.sim.world import Copies, World

FAULT_POLL = 5e-3
"""How often a clock that waits asks the devices for faults [s]."""

ROUNDING = 1e-9
"""Shortest time to wait [s]."""


class Outcome(NamedTuple):
    """The results of a step, as a simulator of another project reports them."""

    reward: float
    """Reward."""
    terminated: bool
    """Whether the episode ends because the task is done."""
    truncated: bool
    """Whether it ends for another reason."""
    info: dict[str, Any]
    """Info for agents and people."""


class Clock:
    """Lets a control step pass: steps a world, waits for devices, or keeps the rate of the wall clock.

    A device that enters its fault state ends a wait at once; the environment sees the fault and ends the episode. Time
    that was missed is not caught up: later steps keep their full period.
    """

    def __init__(
        self,
        world: World | None = None,
        ports: Sequence[Port] = (),
        *,
        frequency: float = 30.0,
        is_real: bool = False,
        is_synchronous: bool = False,
        time_limit: float = 10.0,
        now: Callable[[], float] | None = None,
        sleep: Callable[[float], None] | None = None,
    ) -> None:
        """Keep time.

        Args:
            world: Is stepped by its own mode and frequency; None without a simulation.
            ports: Devices to be watched for faults while waiting, and that a synchronous step waits for.
            frequency: Control steps per second [Hz]; that of the world where there is one.
            is_real: Whether to keep the rate of the wall clock; always so without a world.
            is_synchronous: Wait until the devices have arrived instead of for a period; without a world.
            time_limit: Longest synchronous step of devices [s].
            now: Returns the monotonic time [s]; None for the host's.
            sleep: Waits for some seconds; None for the host's.

        Raises:
            InvalidSetup: A frequency or time limit that is not positive.
        """
        if not frequency > 0 or not time_limit > 0:
            raise InvalidSetup(f"frequency ({frequency}) and time_limit ({time_limit}) must be positive.")
        self.is_real = is_real or world is None
        """Whether steps take real time."""
        self.late = 0.0
        """How much later than due the last step ended [s]."""
        self.frequency = frequency if world is None else world.frequency
        """Control steps per second [Hz]."""
        self.ends: NDArray[np.uint8] = np.zeros(1, np.uint8) if world is None else world.core.ends
        """Why the last step ended, `StepEnd` values per copy."""
        self._world = world
        self._ports = list(ports)
        self._fallible = [port for port in ports if port.can_fail]
        self._waits_for_devices = is_synchronous and world is None
        self._time_limit = time_limit
        self.now = now or time.perf_counter
        """Returns the monotonic time of the host [s]."""
        self._sleep = sleep or time.sleep
        self._next = self.now()

    def outcome(self) -> Outcome | None:
        """Return what comes of the last step, where this clock lets another project's simulator make it; None here."""
        return None

    def advance(self, copies: Copies = None, repeat: Callable[[], None] | None = None) -> None:
        """Let one control step pass, of some copies or of all.

        Args:
            copies: Which; None for all.
            repeat: Tells all devices their targets again; a synchronous step calls it once per period until they have
                arrived. None for nothing.
        """
        if self._waits_for_devices:
            self.ends[0] = self._wait_for_devices(repeat)
        else:
            self.tick(copies)

    def tick(self, copies: Copies = None) -> None:
        """Let one control period pass, of some copies or of all; a synchronous step of devices lasts longer."""
        if self._world is not None:
            self._world.advance(copies)
        if self.is_real:
            self._wait_for_tick()

    def _wait_for_tick(self) -> None:
        self._next += 1.0 / self.frequency
        rest = self._next - self.now()
        self.late = max(-rest, 0.0)
        if rest <= 0:
            self._next = self.now()
        while rest > ROUNDING and not self._has_fault():
            self._sleep(min(rest, FAULT_POLL) if self._fallible else rest)
            rest = self._next - self.now()

    def _has_fault(self) -> bool:
        return any(port.faults() for port in self._fallible)

    def _wait_for_devices(self, repeat: Callable[[], None] | None) -> int:
        period = 1.0 / self.frequency
        start = self.now()
        due = start + period
        while not all(port.has_arrived() for port in self._ports):
            if self._has_fault():
                return StepEnd.interrupted.value
            now = self.now()
            if now - start >= self._time_limit:
                return StepEnd.limit.value
            if repeat is not None and now >= due:
                repeat()
                due = max(due, now - ROUNDING) + period
            self._sleep(1e-3)
        return StepEnd.converged.value

    def reset(self) -> None:
        """Count time from now."""
        self._next = self.now()
        self.late = 0.0
