"""Frames of simulated cameras, delivered as by devices: a new one when it is due, the last one in between.

Each camera has frames at its own rate, in simulated time since the episode's start; one that is due between two control
steps appears at the later one. Rates are ratios of integers, so a camera of 30 frames/s has exactly 30 frames in each
second at 100 control steps/s, however long the episode.

A `CameraFeed` draws within a step and a `RenderThread` beside it.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray
from rcs_data.options import NotNegative, Positive, Record

from rcs.errors import InvalidSetup
from rcs.sim.camera import FrameArrays, SimCameras, Snapshot
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


class FrameClock:
    """Tracks which cameras of which copies have a new frame. Episodes begin with one."""

    memory = ("numbers", "keys", "_start_times", "_next_times")

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

    def most_frames(self, name: str, duration: float) -> int:
        """Return a bound of the number of a camera's frames that are taken in a time [s]."""
        rate = self._rates[name].fps
        if not self._is_synchronous:
            rate = min(rate, 1.0 / self._tick)
        return math.ceil(duration * rate) + 2  # a frame that is due early may be taken late, and steps vary in length

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


class CameraFeed:
    """The newest frame of every camera and copy, drawn inside `read`. Only due frames are drawn."""

    memory = ("held",)

    def __init__(self, cameras: SimCameras, clock: FrameClock) -> None:
        """Deliver the frames of some cameras.

        Args:
            cameras: Draw the frames.
            clock: Says when frames are due; it has all of these cameras and no other user.
        """
        self._cameras = cameras
        self._clock = clock
        self._last: dict[str, FrameArrays] = {}

    @property
    def capture_times(self) -> dict[str, float]:
        """When each camera's last frame was drawn [s], on the monotonic clock."""
        return self._cameras.capture_times

    def read(self) -> dict[str, FrameArrays]:
        """Return the newest frame of each camera, as `SimCameras.read` does: picture, depth and camera pose.

        The arrays are read-only. A camera without a new frame returns the same arrays again.
        """
        is_new = self._clock.take()
        always = [name for name in self._cameras.names if self._clock.has_frame_each_step(name)]
        whole = [name for name in self._cameras.names if name in always or is_new[name].all()]
        self._last.update(self._cameras.read(whole) if whole else {})
        # Cameras with a frame in the same copies are drawn together.
        partly: dict[bytes, list[str]] = {}
        for name in self._cameras.names:
            if name not in whole and is_new[name].any():
                partly.setdefault(is_new[name].tobytes(), []).append(name)
        for flags, names in partly.items():
            copies = np.flatnonzero(np.frombuffer(flags, np.bool_)).astype(np.int32)
            for name, frame in self._cameras.read(names, copies).items():
                last = {key: values.copy() for key, values in self._last[name].items()}
                for key, values in frame.items():
                    last[key][copies] = values
                    last[key].flags.writeable = False
                self._last[name] = last
        return {name: dict(self._last[name]) for name in self._cameras.names}

    @property
    def held(self) -> dict[str, FrameArrays]:
        """Frames of cameras without a new one in each step, which later steps show again."""
        return {name: frame for name, frame in self._last.items() if not self._clock.has_frame_each_step(name)}

    @held.setter
    def held(self, frames: dict[str, FrameArrays]) -> None:
        for frame in frames.values():
            for values in frame.values():
                values.flags.writeable = False
        self._last.update(frames)

    def close(self) -> None:
        """Free the renderer. Closing twice is harmless; reading again makes a new one."""
        self._cameras.close()


class RenderThread:
    """The newest frame of every camera of a world of one copy, drawn by a thread beside a loop in real time.

    A step in which frames are due costs the loop a copy of the state. A frame appears when it is drawn, with the time
    of the state that it shows; where drawing is slower than the cameras' rate, the newest state is drawn next, and the
    ones in between are skipped and counted. The model may change between episodes: frames that are drawn meanwhile are
    never shown.
    """

    def __init__(self, cameras: SimCameras, clock: FrameClock) -> None:
        """Deliver the frames of some cameras. The thread starts with the first `read`.

        Args:
            cameras: They draw for this feed alone.
            clock: Says when a frame is due; it has all of these cameras and no other user.

        Raises:
            InvalidSetup: The cameras' world has many copies.
        """
        if cameras.world.leading:
            raise InvalidSetup("A RenderThread draws one copy; the frames of many copies come from a CameraFeed.")
        self.skipped = dict.fromkeys(cameras.names, 0)
        """Number of frames of each camera that were due and never drawn, because a newer state replaced theirs."""
        self.capture_times: dict[str, float] = {}
        """When the simulation was as each camera's last frame shows it [s], on the monotonic clock."""
        self._cameras = cameras
        self._clock = clock
        self._lock = threading.Lock()
        self._due: dict[str, Snapshot] = {}
        self._drawn: dict[str, tuple[Snapshot, FrameArrays]] = {}
        self._thread: ThreadPoolExecutor | None = None
        self._drawing: Future[None] | None = None
        """Draws until no frame is due; None while the thread has nothing to draw."""

    def read(self) -> dict[str, FrameArrays]:
        """Hand over the present state for the cameras that have a frame due, and return each camera's newest frame.

        An episode begins with frames of its own, for which it waits; otherwise a step never waits for a frame. The
        arrays are read-only, and a frame that is seen again is the same arrays.

        Raises:
            RcsError: The thread could not draw; it has ended.
        """
        is_new = self._clock.take()
        is_start = self._clock.steps[0] == 0 or not self._drawn
        names = [name for name in self._cameras.names if is_start or is_new[name][0]]
        snapshot = self._cameras.snapshot(names) if names else None
        with self._lock:
            if is_start:
                self._due.clear()
            for name in names:
                self.skipped[name] += name in self._due
                assert snapshot is not None
                self._due[name] = snapshot
            if self._due and self._drawing is None:
                self._thread = self._thread or ThreadPoolExecutor(1, "render cameras")
                self._drawing = self._thread.submit(self._draw)
            drawing = self._drawing
        if drawing is not None and (is_start or drawing.done()):
            drawing.result()
        with self._lock:
            newest = dict(self._drawn)
        self.capture_times = {name: newest[name][0].time for name in self._cameras.names}
        return {name: dict(newest[name][1]) for name in self._cameras.names}

    def _draw(self) -> None:
        while True:
            with self._lock:
                due, self._due = self._due, {}
                if not due:
                    self._drawing = None
                    return
            for snapshot in dict.fromkeys(due.values()):
                names = [name for name in due if due[name] is snapshot]
                for name, frame in self._cameras.draw(snapshot, names):
                    with self._lock:
                        self._drawn[name] = (snapshot, frame)

    def close(self) -> None:
        """End the thread and free the renderer. Closing twice is harmless; reading again starts anew."""
        with self._lock:
            self._due.clear()
        if self._thread is not None:
            self._thread.shutdown()
        self._thread = self._drawing = None
        self._drawn.clear()
        self._cameras.close()
