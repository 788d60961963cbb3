"""The clock of simulated cameras: each has frames at its own rate, in simulated time since the episode's start.

A frame due between two control steps appears at the later one. Rates are ratios of integers, so a camera of 30 frames/s
has exactly 30 frames in each second at 100 control steps/s, however long the episode.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from rcs_data.record import NotNegative, Positive, Record

from rcs.robots.description import CameraDescription
from rcs.sim.splitmix import branch, numbered
from rcs.sim.world import Copies, World


class FrameRate(Record):
    """The frame rate of a camera."""

    fps: Positive
    """Frames per second."""
    longest_exposure: NotNegative = 0.0
    """If this exceeds the frame period, intervals are uniformly distributed between the two [s]."""

    @property
    def is_rolling(self) -> bool:
        """True if intervals differ from frame to frame."""
        return self.longest_exposure > 1.0 / self.fps

    @staticmethod
    def of(camera: CameraDescription, size: tuple[int, int], wanted: float | None = None) -> FrameRate:
        """Return the rate of a camera for frames of a size.

        Args:
            camera: Its figures.
            size: Width and height [px].
            wanted: The wanted rate [frames/s]; None for the highest.

        Raises:
            InvalidSetup: The camera does not offer that rate for that size.
        """
        return FrameRate(fps=camera.frame_rate(size, wanted), longest_exposure=camera.longest_exposure)


class FrameClock:
    """Tracks which cameras of which copies have a new frame. Episodes begin with one."""

    memory = ("numbers", "_start_times", "_next_times")

    def __init__(self, world: World, rates: Mapping[str, FrameRate]) -> None:
        """Start counting.

        Args:
            world: The world whose time counts.
            rates: The rate of each camera, by name.
        """
        self._world = world
        self._is_synchronous = world.stepping == "sync"
        step = Fraction(world.model.opt.timestep).limit_denominator(10**9)
        frequency = Fraction(world.frequency).limit_denominator(10**6)
        # Synchronous steps vary in length, so physics steps are counted instead.
        tick = step if self._is_synchronous else 1 / frequency
        self._tick = float(tick)
        self._rates = dict(rates)
        self._frames_per_tick = {
            name: Fraction(rate.fps).limit_denominator(10**6) * tick for name, rate in rates.items()
        }
        copies = world.copies
        self.numbers = {name: np.full(copies, -1, np.int64) for name in rates}
        """Number of the newest frame since the start of the episode, (copies,), counted from 0 as by the device."""
        self.steps: NDArray[np.int64] = world.core.steps
        """Control steps since the start of each copy's episode, (copies,): live counts of the world. A program that
        shows recorded states replaces them by its own."""
        self.keys = np.zeros(copies, np.uint64)
        """Random bits of the present episodes, (copies,)."""
        self._start_times = np.zeros(copies)
        rolling = [name for name, rate in rates.items() if rate.is_rolling]
        self._next_times = {name: np.zeros(copies) for name in rolling}

    def begin(self, keys: NDArray[np.uint64], copies: Copies = None) -> None:
        """Start episodes.

        Args:
            keys: Random bits for the intervals of cameras with varying rate, one per copy.
            copies: The copies; None for all.
        """
        self.keys[slice(None) if copies is None else copies] = keys

    def has_frame_each_step(self, name: str) -> bool:
        """Return whether a camera has a new frame after every control step."""
        if self._is_synchronous:
            return False
        return self._frames_per_tick[name] >= 1 and self._rates[name].longest_exposure <= self._tick

    def take(self) -> dict[str, NDArray[np.bool_]]:
        """Return which copies have a new frame since the last call, (copies,) for each camera."""
        # Also without `begin`, in a world that is reset by hand.
        starts = self.steps == 0
        ticks = self._count_physics_steps(starts) if self._is_synchronous else self.steps
        is_new: dict[str, NDArray[np.bool_]] = {}
        for name, rate in self._rates.items():
            if rate.is_rolling:
                numbers = self._roll(name, ticks, starts)
            else:
                ratio = self._frames_per_tick[name]
                numbers = ticks * ratio.numerator // ratio.denominator
            is_new[name] = starts | (numbers != self.numbers[name])
            self.numbers[name] = numbers
        return is_new

    def _count_physics_steps(self, starts: NDArray[np.bool_]) -> NDArray[np.int64]:
        times = np.atleast_1d(self._world.time)
        self._start_times[starts] = times[starts]
        return np.rint((times - self._start_times) / self._tick).astype(np.int64)

    def _roll(self, name: str, ticks: NDArray[np.int64], starts: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the numbers of the newest frames of a camera whose intervals differ."""
        next_times, numbers = self._next_times[name], self.numbers[name].copy()
        numbers[starts], next_times[starts] = -1, 0.0
        now = ticks * self._tick
        while len(late := np.flatnonzero(next_times <= now)):
            numbers[late] += 1
            next_times[late] += self._intervals(name, numbers[late], self.keys[late])
        return numbers

    def _intervals(self, name: str, numbers: NDArray[np.int64], keys: NDArray[np.uint64]) -> NDArray[np.float64]:
        """Return the intervals of frames [s], determined by episode, camera name and frame number."""
        shortest, longest = 1.0 / self._rates[name].fps, self._rates[name].longest_exposure
        return shortest + (longest - shortest) * numbered(branch(keys, name), numbers)
