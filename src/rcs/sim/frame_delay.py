"""Delivers frames some time after their capture, as the bus and the driver of a real camera do.

An episode begins with a frame that is new. From then on, a step sees the newest frame that has arrived: one that was
captured at or before the end of the step less the latency. Frames are captured at the ends of steps, so their ages are
at least the latency, and less than one period of steps or of the camera more.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.sim.camera import FrameArrays
from rcs.sim.camera_feed import CameraFeed
from rcs.sim.frame_clock import FrameClock
from rcs.sim.pixels import PixelFeed
from rcs.sim.render_thread import RenderThread
from rcs.sim.splitmix import GAMMA, mix, units
from rcs.sim.world import World

ROUNDING = 1e-9
"""Sums of physics steps are not exact; a frame that is due this much later has arrived [s]."""


@dataclass(frozen=True)
class _Frame:
    """What a feed gave in one step. Arrays are (copies,)."""

    arrays: FrameArrays
    captured: NDArray[np.float64]
    """When each copy was as its frame shows it [s], simulated time; in real time, on the host's monotonic clock."""
    arrives: NDArray[np.float64]
    """When it can be seen [s]."""
    drawn: NDArray[np.float64]
    """When it was drawn [s], on the host's monotonic clock."""


class DelayedFrames:
    """Takes the place of the feed whose frames it holds back, for one copy and for many."""

    def __init__(
        self,
        feed: CameraFeed | RenderThread | PixelFeed,
        clock: FrameClock,
        world: World,
        latency: Callable[[], Mapping[str, NDArray[np.float64]]],
        jitter: float = 0.0,
    ) -> None:
        """Hold back the frames of a feed.

        Args:
            feed: The newest frames.
            clock: The feed's.
            world: The world of the cameras.
            latency: Returns the present latency of each camera by name [s], (*leading,).
            jitter: Largest time that a single frame takes longer [s]; drawn anew for each frame.
        """
        self._feed = feed
        self._clock = clock
        self._world = world
        self._latency = latency
        self._jitter = jitter
        self._is_real = isinstance(feed, RenderThread)
        self._waiting: dict[str, list[_Frame]] = {}
        self._numbers: dict[str, NDArray[np.int64]] = {}
        self.capture_times: dict[str, Any] = {}
        """When each camera's frame was drawn [s], on the monotonic clock; of many copies, (copies,)."""
        self.ages: dict[str, NDArray[np.float64]] = {}
        """How old each camera's frame is [s], (*leading,): in simulated time, or in real time on the wall clock."""

    def read(self) -> dict[str, FrameArrays]:
        """Return the newest frame of each camera that has arrived, as the feed gives them; arrays are read-only."""
        newest, latency = self._feed.read(), self._latency()
        now = np.array([time.perf_counter()]) if self._is_real else np.array(np.atleast_1d(self._world.time))
        return {name: self._read(name, arrays, now, latency[name]) for name, arrays in newest.items()}

    def _read(
        self, name: str, arrays: FrameArrays, now: NDArray[np.float64], latency: NDArray[np.float64]
    ) -> FrameArrays:
        waiting = self._waiting.setdefault(name, [])
        waiting.insert(0, self._take(name, arrays, now, latency, waiting[0] if waiting else None))
        # For each copy, the first one that has arrived. That of an episode's start always has, before those of others.
        chosen = np.stack([one.arrives <= now + ROUNDING for one in waiting]).argmax(axis=0)
        del waiting[int(chosen.max()) + 1 :]
        captured = _pick([one.captured for one in waiting], chosen)
        drawn = _pick([one.drawn for one in waiting], chosen)
        leading = self._world.leading
        self.ages[name] = (now - captured).reshape(leading)
        self.capture_times[name] = drawn if leading else float(drawn[0])
        if (chosen == chosen[0]).all():
            return dict(waiting[int(chosen[0])].arrays)
        return {key: _pick([one.arrays[key] for one in waiting], chosen) for key in arrays}

    def _take(
        self,
        name: str,
        arrays: FrameArrays,
        now: NDArray[np.float64],
        latency: NDArray[np.float64],
        before: _Frame | None,
    ) -> _Frame:
        is_start = np.array(self._world.core.steps == 0)
        numbers = self._clock.numbers[name].copy()
        drawn = np.full(len(now), self._feed.capture_times[name])
        captured = drawn if self._is_real else now
        if before is None:
            is_start[:] = is_new = True
        elif self._is_real:
            is_new = is_start | (drawn != before.drawn)
        else:
            is_new = is_start | (numbers != self._numbers[name])
        self._numbers[name] = numbers
        arrives = captured + np.reshape(latency, -1) + self._jitter * self._drawn_jitter(name, numbers)
        arrives = np.where(is_start, -np.inf, arrives)
        if before is not None:
            captured, arrives, drawn = (
                np.where(is_new, mine, last)
                for mine, last in ((captured, before.captured), (arrives, before.arrives), (drawn, before.drawn))
            )
        return _Frame(arrays, captured, arrives, drawn)

    def _drawn_jitter(self, name: str, numbers: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return a number 0 … 1 for each copy, determined by episode, camera and frame."""
        with np.errstate(over="ignore"):
            stream = mix(self._clock.keys ^ mix(np.array([zlib.crc32(f"late {name}".encode())], np.uint64) + GAMMA))
            return units(mix(stream + numbers.astype(np.uint64) * GAMMA))

    def close(self) -> None:
        """Close the feed."""
        self._waiting.clear()
        self._feed.close()


def _pick(entries: list[NDArray[Any]], chosen: NDArray[np.intp]) -> NDArray[Any]:
    """Return for each copy its row of the entry that is chosen for it."""
    picked = entries[0].copy()
    for i, entry in enumerate(entries[1:], start=1):
        picked[chosen == i] = entry[chosen == i]
    picked.flags.writeable = False
    return picked
