"""Frames that are held back, as by the bus and the driver of a real camera."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rcs.sim.camera import FrameArrays
from rcs.sim.camera_feed import CameraFeed, FrameClock, RenderThread
from rcs.sim.pixels import PixelFeed
from rcs.sim.splitmix import branch, numbered
from rcs.sim.world import World

ROUNDING = 1e-9
"""Sums of physics steps are not exact; a frame that is due this much later has arrived [s]."""

TIMES = "times"
"""Key of the times of a frame in the memory of `DelayedFrames`, beside those of its arrays."""


class _Frame(NamedTuple):
    """Frames of a camera after one step."""

    arrays: FrameArrays
    times: NDArray[np.float64]
    """When each copy was as its frame shows it [s], in simulated time or on the host's monotonic clock; when the frame
    can be seen; and when it was drawn, on the host's clock; (3, copies)."""


class DelayedFrames:
    """Holds back the frames of a feed and takes its place, for one copy and for many.

    An episode begins with a frame that is new. From then on, a step sees the newest frame that has arrived: one that
    was captured at or before the end of the step less the latency. Frames are captured at the ends of steps, so their
    ages are at least the latency, and less than one period of steps or of the camera more.
    """

    memory = ("_feed", "numbers", "waiting")

    def __init__(
        self,
        feed: CameraFeed | RenderThread | PixelFeed,
        clock: FrameClock,
        world: World,
        latency: Callable[[], Mapping[str, NDArray[np.float64]]],
        *,
        longest: float,
        jitter: float,
    ) -> None:
        """Hold back the frames of a feed.

        Args:
            feed: The newest frames.
            clock: The feed's.
            world: The world of the cameras.
            latency: Returns the present latency of each camera by name [s], (*leading,).
            longest: Largest latency [s].
            jitter: Largest time that a single frame takes longer [s]; drawn anew for each frame.
        """
        self._feed = feed
        self._clock = clock
        self._world = world
        self._latency = latency
        self._jitter = jitter
        self._longest = longest + jitter + ROUNDING
        self._is_real = isinstance(feed, RenderThread)
        self._waiting: dict[str, list[_Frame]] = {}
        self.numbers: dict[str, NDArray[np.int64]] = {}
        """Number of each camera's frame that was read last, (*leading,)."""
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
        chosen = np.stack([one.times[1] <= now + ROUNDING for one in waiting]).argmax(axis=0)
        del waiting[int(chosen.max()) + 1 :]
        captured, _, drawn = np.take_along_axis(np.stack([one.times for one in waiting]), chosen[None, None], axis=0)[0]
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
        is_start = np.array(self._clock.steps == 0) | (before is None)
        numbers = self._clock.numbers[name].copy()
        drawn = np.full(len(now), self._feed.capture_times[name])
        captured = drawn if self._is_real else now
        # 0 … 1 for each copy, determined by episode, camera and frame.
        late = numbered(branch(self._clock.keys, f"late {name}"), numbers)
        arrives = captured + np.reshape(latency, -1) + self._jitter * late
        times = np.stack([captured, np.where(is_start, -np.inf, arrives), drawn])
        if before is not None:
            has_new = drawn != before.times[2] if self._is_real else numbers != self.numbers[name].reshape(-1)
            times = np.where(is_start | has_new, times, before.times)
        self.numbers[name] = numbers.reshape(self._world.leading)
        return _Frame(arrays, times)

    @property
    def waiting(self) -> dict[str, dict[str, NDArray[Any]]]:
        """The frame of each camera that is seen and those after it, (*leading, frames, ...), the newest first.

        They are as many as there can be; the oldest stands in every place that is left.
        """
        return {name: self._rows_of(name, frames) for name, frames in self._waiting.items()}

    @waiting.setter
    def waiting(self, rows: Mapping[str, Mapping[str, NDArray[Any]]]) -> None:
        self._waiting = {name: self._frames_of(own) for name, own in rows.items()}

    def _rows_of(self, name: str, frames: Sequence[_Frame]) -> dict[str, NDArray[Any]]:
        copies, leading = np.arange(self._world.copies), self._world.leading
        # A frame that steps have read again is there once, in each copy.
        captured = np.stack([frame.times[0] for frame in frames])
        is_another = np.ones(captured.shape, np.bool_)
        is_another[1:] = captured[1:] != captured[:-1]
        order = np.argsort(~is_another, axis=0, kind="stable")
        count = self._clock.most_frames(name, self._longest) + 1
        chosen = order[np.minimum(np.arange(count)[:, None], is_another.sum(axis=0) - 1), copies]

        def rows(values: list[NDArray[Any]]) -> NDArray[Any]:
            """Return the chosen ones of values (copies, ...)."""
            of_copies = np.stack(values)[chosen, copies].swapaxes(0, 1)
            return of_copies.reshape(*leading, *of_copies.shape[1:])

        arrays = {key: rows([self._by_copy(frame.arrays[key]) for frame in frames]) for key in frames[0].arrays}
        return {**arrays, TIMES: rows([frame.times.T for frame in frames])}

    def _frames_of(self, rows: Mapping[str, NDArray[Any]]) -> list[_Frame]:
        kept = {key: self._by_copy(values) for key, values in rows.items()}
        frames: list[_Frame] = []
        for i in range(kept[TIMES].shape[1]):
            arrays: FrameArrays = {}
            for key, values in kept.items():
                if key != TIMES:
                    arrays[key] = values[:, i].reshape(*self._world.leading, *values.shape[2:]).copy()
                    arrays[key].flags.writeable = False
            frames.append(_Frame(arrays, kept[TIMES][:, i].T.copy()))
        return frames

    def _by_copy(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values (*leading, ...) as (copies, ...)."""
        return values.reshape(self._world.copies, *values.shape[len(self._world.leading) :])

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
