"""The threads that encode images and write rows, shared by all episodes that a process records in the background."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from queue import SimpleQueue

from rcs_data.closing import Closing
from rcs_data.errors import InvalidSetup, WrongOrder

MOST_THREADS = 4
"""Threads by default, given as many CPUs: six cameras of 1280 x 720 at 30 Hz keep two busy."""


class Encoders(Closing):
    """Threads that take work in order, several pieces at a time; a context manager."""

    def __init__(self, threads: int | None = None) -> None:
        """Start the threads.

        Args:
            threads: How many; None for one per CPU that this process may use, at most `MOST_THREADS`.

        Raises:
            InvalidSetup: Fewer than one thread.
        """
        count = min(MOST_THREADS, _usable_cpus()) if threads is None else threads
        if count < 1:
            raise InvalidSetup(f"threads is {threads}; valid is a whole number from 1, or None.")
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

    @property
    def threads(self) -> int:
        """Number of threads."""
        return len(self._threads)

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
