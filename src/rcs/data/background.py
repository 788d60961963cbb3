"""Writes an episode in a thread of its own, so that a control loop never waits for an encoder or a disk.

The loop hands over copies of its rows and goes on. What waits is bounded: when the thread falls behind by more than the
bound, new images are left out, each with a flag in its row, and the rows go on; only when even the rows would be too
many are whole rows left out. Both are counted and reported, and the first of an episode is logged.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from rcs.data.episode_writer import EpisodeWriter, State
from rcs.data.flags import FrameFlag, companion
from rcs.data.info import DatasetInfo
from rcs.data.reader import EpisodeRecord
from rcs.data.rows import Value
from rcs.errors import RcsError

_log = logging.getLogger(__name__)

DEFAULT_BOUND_BYTES = 256 << 20
"""Images that may wait: over two seconds of two RGB-D cameras of 640 x 480 at 30 Hz."""
_MAX_ROWS = 10_000


class BackgroundEpisode:
    """An episode whose rows are encoded and written by a thread; takes the place of an `EpisodeWriter`."""

    def __init__(self, episode: EpisodeWriter, info: DatasetInfo, *, bound_bytes: int = DEFAULT_BOUND_BYTES) -> None:
        """Take over an episode that was just started.

        Args:
            episode: The episode; nobody else may write to it from now on.
            info: What a row has.
            bound_bytes: How many bytes of images may wait.
        """
        self.id = episode.id
        self._episode = episode
        self._bound = bound_bytes
        self._images = {f.key: companion(f.key, info.features, "flags") for f in info.features if f.is_image}
        self._waiting: deque[tuple[dict[str, Value], NDArray[np.float64] | None, int]] = deque()
        self._waiting_bytes = 0
        self._changed = threading.Condition()
        self._is_ending = False
        self._error: RcsError | None = None
        self._rows = 0
        self.dropped_images = 0
        self.dropped_rows = 0
        self._most_bytes = 0
        self._thread = threading.Thread(target=self._write, name=f"write episode {episode.id}", daemon=True)
        self._thread.start()
        episode.end = self.abort  # not beside the thread: first it writes what waits

    @property
    def state(self) -> State:
        """Whether the episode is open, finished, discarded or aborted."""
        return self._episode.state

    @property
    def rows(self) -> int:
        """How many rows were taken, the reset observation included."""
        return self._rows

    def add(self, row: Mapping[str, Value], sim_state: NDArray[np.float64] | None = None) -> None:
        """Take one step and return at once; arrays are copied.

        Args:
            row: As `EpisodeWriter.add` takes it.
            sim_state: As `EpisodeWriter.add` takes it.

        Raises:
            InvalidSetup: A key, shape, dtype or time is wrong; the row is not taken, and the episode stays open.
            DatasetError: The disk is full or failed since the row before; the episode is aborted.
        """
        self._raise_error()
        self._episode.check(row, sim_state, is_first=self._rows == 0)
        given = dict(row)
        size = sum(value.nbytes for key in self._images if isinstance(value := row.get(key), np.ndarray))
        with self._changed:
            if len(self._waiting) >= _MAX_ROWS:
                self._count_drop(rows=1)
                return
            if size and self._waiting_bytes + size > self._bound:
                size = self._leave_out_images(given)
        kept: dict[str, Value] = {
            key: value.copy() if isinstance(value, np.ndarray) else value for key, value in given.items()
        }
        state = None if sim_state is None else sim_state.copy()
        with self._changed:
            self._waiting.append((kept, state, size))
            self._waiting_bytes += size
            self._most_bytes = max(self._most_bytes, self._waiting_bytes)
            self._rows += 1
            self._changed.notify()

    def finish(
        self, success: bool | None, outcome: Mapping[str, Any] | None = None, *, instruction: str | None = None
    ) -> EpisodeRecord:
        """Write what waits, complete the episode and return it.

        Args:
            success: Whether the task was done; None if that is not known.
            outcome: What else is to be kept about how it went.
            instruction: What the robot was asked to do; None for what was said at the start.

        Raises:
            InvalidSetup: There are no rows, or the outcome is not JSON.
            DatasetError: The disk is full or failed; the episode is aborted.
        """
        self._end()
        self._raise_error()
        quality = {
            "writer": {
                "dropped_images": self.dropped_images,
                "dropped_rows": self.dropped_rows,
                "most_bytes_waiting": self._most_bytes,
            }
        }
        return self._episode.finish(success, outcome, instruction=instruction, quality=quality)

    def discard(self) -> None:
        """Forget what waits and remove the episode with all its rows."""
        with self._changed:
            self._waiting.clear()
        self._end()
        self._episode.discard()

    def abort(self, reason: str) -> None:
        """Write what waits and give the episode up, but keep its rows for `recover`.

        Args:
            reason: Why, in words; it is kept.
        """
        self._end()
        self._episode.abort(reason)

    def __enter__(self) -> Self:
        """Return the episode itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        """Abort the episode unless it is finished or discarded."""
        if self.state == "open":
            self.abort("left without finish" if kind is None else f"{kind.__name__}: {error}")

    def _leave_out_images(self, row: dict[str, Value]) -> int:
        images = [key for key in self._images if row.get(key) is not None]
        for key in images:
            row[key] = None
            flags = self._images[key]
            if flags is not None:
                before: Any = row.get(flags)
                row[flags] = int(FrameFlag(int(before or 0)) | FrameFlag.DROPPED)
        self._count_drop(images=len(images))
        return 0

    def _count_drop(self, *, images: int = 0, rows: int = 0) -> None:
        if not self.dropped_images and not self.dropped_rows:
            _log.warning(
                "Episode %r: the writer is slower than the loop; with %.0f MB waiting, %s are left out.",
                self.id,
                self._waiting_bytes / 1e6,
                "rows" if rows else "images",
            )
        self.dropped_images += images
        self.dropped_rows += rows

    def _write(self) -> None:
        while True:
            with self._changed:
                while not self._waiting and not self._is_ending:
                    self._changed.wait()
                if not self._waiting:
                    return
                row, sim_state, size = self._waiting.popleft()
            try:
                self._episode.add(row, sim_state)
            except RcsError as err:
                self._error = err
                return
            with self._changed:
                self._waiting_bytes -= size

    def _end(self) -> None:
        with self._changed:
            self._is_ending = True
            self._changed.notify()
        self._thread.join()

    def _raise_error(self) -> None:
        if self._error is not None:
            raise self._error
