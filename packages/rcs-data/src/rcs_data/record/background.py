"""Writes an episode in background threads, so that a control loop never waits for an encoder or a disk.

The loop hands over its rows and goes on. Threads shared by all open episodes encode the images, several at a time, and
write the rows in their order. The queue is bounded: when the threads fall behind, new images are dropped, each with a
flag in its row; whole rows are dropped only when even they are too many. Both are counted and reported, and the first
of an episode is logged.
"""

from __future__ import annotations

import logging
import os
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from queue import SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from rcs_data.errors import WrongOrder
from rcs_data.files.closing import Closing
from rcs_data.files.codec import encode_frame
from rcs_data.files.flags import FrameFlag, companion
from rcs_data.read.reader import EpisodeRecord
from rcs_data.record.episode_writer import EpisodeWriter, State
from rcs_data.record.rows import Value

_log = logging.getLogger(__name__)

DEFAULT_BOUND_BYTES = 256 << 20
"""Images that may wait: half a second of six RGB cameras of 1280 x 720 at 30 Hz."""
_MAX_ROWS = 10_000
MOST_THREADS = 4
"""Threads, given as many CPUs: six cameras of 1280 x 720 at 30 Hz keep two busy."""


class Encoders(Closing):
    """Threads that take work in order, several pieces at a time; a context manager."""

    def __init__(self) -> None:
        """Start the threads: one per CPU that this process may use, at most `MOST_THREADS`."""
        count = min(MOST_THREADS, _usable_cpus())
        self.lock = threading.Lock()
        """Guards `waiting_bytes` and all else that episodes share with the threads."""
        self.waiting_bytes = 0
        """Queued images, encoded or not, of all episodes [B]."""
        self.process = os.getpid()
        self.users = 0
        self._work: SimpleQueue[Callable[[], object] | None] = SimpleQueue()
        # Daemons, so that a program that ends without closing its dataset does not wait for a hanging disk.
        self._threads = [threading.Thread(target=self._run, name=f"encode {i}", daemon=True) for i in range(count)]
        for thread in self._threads:
            thread.start()

    def submit(self, work: Callable[[], object]) -> None:
        """Run a function that raises nothing on a thread.

        Raises:
            WrongOrder: The threads have ended.
        """
        if not self._threads:
            raise WrongOrder("The encoders are closed; finish the episodes that use them first.")
        self._work.put(work)

    def close(self) -> None:
        """Finish what was submitted and end the threads; twice is harmless."""
        threads, self._threads = self._threads, []
        for _ in threads:
            self._work.put(None)
        for thread in threads:
            thread.join()

    def _run(self) -> None:
        while (work := self._work.get()) is not None:
            work()


_guard = threading.Lock()
_shared: list[Encoders] = []


def borrow() -> Encoders:
    """Return the threads of this process; the first call starts them."""
    with _guard:
        if _shared and _shared[0].process != os.getpid():
            _shared.clear()  # threads do not survive a fork
        if not _shared:
            _shared.append(Encoders())
        _shared[0].users += 1
        return _shared[0]


def give_back(encoders: Encoders) -> None:
    """Give back what `borrow` returned; the last one ends the threads."""
    with _guard:
        encoders.users -= 1
        is_last = encoders.users == 0
        if is_last and encoders in _shared:
            _shared.remove(encoders)
    if is_last:
        encoders.close()


def _usable_cpus() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@dataclass(slots=True, eq=False)
class _Row:
    """A row on its way to the disk."""

    values: dict[str, Value]
    sim_state: NDArray[np.float64] | None
    missing: int
    """Images that are not encoded yet."""
    counted: int = 0
    """Its bytes in the queue; 0 before it is queued and after it is dropped."""
    is_forgotten: bool = False
    error: Exception | None = None
    """Why an image could not be encoded."""


class BackgroundEpisode:
    """An `EpisodeWriter` whose rows are encoded and written by background threads."""

    def __init__(self, episode: EpisodeWriter, *, bound_bytes: int = DEFAULT_BOUND_BYTES) -> None:
        """Take over an episode that has just started.

        Args:
            episode: The episode; nobody else may write to it from now on.
            bound_bytes: How many bytes of images may wait, of all episodes of this process.
        """
        self.id = episode.id
        self._episode = episode
        self._bound = bound_bytes
        features = episode.info.features
        self._images = {f.key: f for f in features if f.is_image}
        self._flags = {key: companion(key, features, "flags") for key in self._images}
        self._lost: set[str] = set()
        """Images of which the newest was left out."""
        self._encoders = borrow()
        self._is_borrowing = True
        self._lock = self._encoders.lock
        self._is_written = threading.Condition(self._lock)
        self._waiting: deque[_Row] = deque()
        self._is_writing = False
        self._error: Exception | None = None
        self.rows = 0
        """Rows taken, the reset observation included."""
        self.dropped_images = 0
        self.dropped_rows = 0
        self._most_bytes = 0
        episode.end = self.abort  # the threads must first write what is queued

    @property
    def state(self) -> State:
        """Whether the episode is open, finished, discarded or aborted."""
        return self._episode.state

    def add(self, row: Mapping[str, Value], sim_state: NDArray[np.float64] | None = None) -> None:
        """Queue one step as `EpisodeWriter.add` takes it, and return at once; arrays that are not read-only are copied.

        Raises:
            InvalidSetup: A key, shape, dtype or time is wrong; the row is not taken, and the episode stays open.
            DatasetError: The disk is full or failed since the row before; the episode is aborted.
        """
        self._raise_error()
        self._episode.check(row, sim_state, is_first=self.rows == 0)
        given = dict(row)
        with self._lock:
            if len(self._waiting) >= _MAX_ROWS:
                self._lost |= {key for key in self._images if given.get(key) is not None}
                self._count_drop(rows=1)
                return
            size = sum(_bytes_of(given.get(key)) for key in self._images)
            if size and self._encoders.waiting_bytes + size > self._bound:
                self._leave_out_images(given)
        self._flag_lost(given)
        kept = {key: _own(value) for key, value in given.items()}
        new = [key for key in self._images if isinstance(kept.get(key), np.ndarray)]
        taken = _Row(kept, None if sim_state is None else _own(sim_state), missing=len(new))
        # Encoding begins before the row is queued: a row that Ctrl-C interrupts is lost, but nothing waits for ever.
        for key in new:
            self._encoders.submit(partial(self._encode, taken, key))
        with self._lock:
            taken.counted = sum(_bytes_of(kept.get(key)) for key in self._images)
            self._encoders.waiting_bytes += taken.counted
            self._most_bytes = max(self._most_bytes, self._encoders.waiting_bytes)
            self._waiting.append(taken)
            self.rows += 1
            is_encoded = not taken.missing
        if is_encoded:  # otherwise it is written after its last image
            self._encoders.submit(self._write)

    def finish(
        self, success: bool | None, outcome: Mapping[str, Any] | None = None, *, instruction: str | None = None
    ) -> EpisodeRecord:
        """Write what is queued, complete the episode and return it.

        Args:
            success: Whether the task was done; None if that is not known.
            outcome: Further facts to keep about how it went.
            instruction: The instruction that the robot had; None for the instruction given at the start.

        Raises:
            InvalidSetup: There are no rows, or the outcome is not JSON; the episode stays open.
            DatasetError: The disk is full or failed; the episode is aborted.
        """
        self._write_all()
        self._raise_error()
        timing = {
            "writer": {
                "dropped_images": self.dropped_images,
                "dropped_rows": self.dropped_rows,
                "most_bytes_waiting": self._most_bytes,
            }
        }
        try:
            return self._episode.finish(success, outcome, instruction=instruction, timing=timing)
        finally:
            self._let_go()

    def discard(self) -> None:
        """Drop what is queued and remove the episode with all its rows."""
        with self._lock:
            self._forget()
        self._write_all()
        try:
            self._episode.discard()
        finally:
            self._let_go()

    def abort(self, reason: str) -> None:
        """Write what is queued and abort the episode, but keep its rows, and beside them the reason, for `recover`."""
        self._write_all()
        try:
            self._episode.abort(reason)
        finally:
            self._let_go()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
        """Abort the episode unless it is finished or discarded."""
        if self.state == "open":
            self.abort("left without finish" if kind is None else f"{kind.__name__}: {error}")

    def _leave_out_images(self, row: dict[str, Value]) -> None:
        images = [key for key in self._images if row.get(key) is not None]
        for key in images:
            row[key] = None
            flags = self._flags[key]
            if flags is not None:
                before: Any = row.get(flags)
                row[flags] = int(FrameFlag(int(before or 0)) | FrameFlag.DROPPED)
        self._lost.update(images)
        self._count_drop(images=len(images))

    def _flag_lost(self, row: dict[str, Value]) -> None:
        """Flag images that were left out, in the rows that repeat them, too."""
        for key, flags in self._flags.items():
            if row.get(key) is not None:
                self._lost.discard(key)
            elif key in self._lost and flags is not None and (before := row.get(flags)):  # else a frame is missing
                row[flags] = int(FrameFlag(int(before)) | FrameFlag.DROPPED)

    def _count_drop(self, *, images: int = 0, rows: int = 0) -> None:
        if not self.dropped_images and not self.dropped_rows:
            _log.warning(
                "Episode %r: the writer is slower than the loop; with %.0f MB waiting, %s are dropped.",
                self.id,
                self._encoders.waiting_bytes / 1e6,
                "rows" if rows else "images",
            )
        self.dropped_images += images
        self.dropped_rows += rows

    def _encode(self, row: _Row, key: str) -> None:
        """Put the bytes of an image in its place, and write the row if it was the last one missing."""
        image: Any = row.values[key]
        data = b""
        try:
            if not row.is_forgotten:
                data = encode_frame(self._images[key], image, self._episode.info)
        except Exception as err:  # noqa: BLE001  raised where the loop is, when it is this row's turn
            row.error = err
        with self._lock:
            row.values[key] = data
            row.missing -= 1
            if row.counted:
                self._encoders.waiting_bytes -= image.nbytes - len(data)
                row.counted -= image.nbytes - len(data)
        self._write()

    def _write(self) -> None:
        """Write rows up to the first that is not encoded; one thread at a time does it for all."""
        with self._lock:
            if self._is_writing:
                return
            self._is_writing = True
        while (row := self._next_encoded()) is not None:
            try:
                if error := self._error or row.error:
                    raise error
                self._episode.add(row.values, row.sim_state)
            except Exception as err:  # noqa: BLE001  raised where the loop is, by its next call
                self._error = err
            with self._lock:
                self._encoders.waiting_bytes -= row.counted
                if self._error is not None:
                    self._forget()

    def _next_encoded(self) -> _Row | None:
        with self._lock:
            if self._waiting and not self._waiting[0].missing:
                return self._waiting.popleft()
            self._is_writing = False
            self._is_written.notify_all()
            return None

    def _forget(self) -> None:
        """Drop the queued rows; the caller holds the lock."""
        for row in self._waiting:
            row.is_forgotten = True
            self._encoders.waiting_bytes -= row.counted
            row.counted = 0
        self._waiting.clear()

    def _write_all(self) -> None:
        """Wait until the queue is empty and nothing is being written."""
        with self._lock:
            if self._waiting:
                self._encoders.submit(self._write)  # Ctrl-C may have interrupted `add` before it said so
            self._is_written.wait_for(lambda: not self._waiting and not self._is_writing)

    def _raise_error(self) -> None:
        if self._error is not None:
            self._let_go()
            raise self._error

    def _let_go(self) -> None:
        """Give the threads back, unless more rows may follow."""
        if self.state != "open" and self._is_borrowing:
            self._is_borrowing = False
            give_back(self._encoders)


def _bytes_of(value: object) -> int:
    return value.nbytes if isinstance(value, np.ndarray) else len(value) if isinstance(value, bytes) else 0


def _own(value: Any) -> Any:
    """Return a value that cannot change: a copy of every writable array."""
    return value.copy() if isinstance(value, np.ndarray) and not _is_frozen(value) else value


def _is_frozen(array: NDArray[Any]) -> bool:
    """Return whether an array and whatever it is a view of are read-only."""
    owner: object = array
    while isinstance(owner, np.ndarray):
        if owner.flags.writeable:
            return False
        owner = owner.base
    return owner is None or isinstance(owner, bytes)
