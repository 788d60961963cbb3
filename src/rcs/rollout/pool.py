"""Worker processes that each make one thing and then answer numbers with results.

Workers die with their parent (Linux tells them; elsewhere they see their pipe end), so that no writer outlives the lock
on its dataset. Ctrl-C is the parent's business: workers finish what they have at work.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from multiprocessing import get_context
from types import TracebackType
from typing import Any, Protocol, Self

from rcs.errors import RcsError


class Worker(Protocol):
    """What a worker process makes."""

    def attempt(self, number: int) -> Any:
        """Answer a number."""
        ...

    def close(self) -> None:
        """Let go of everything."""
        ...


class WorkerPool:
    """Processes that answer numbers, in the order in which they are done."""

    def __init__(self, make: Callable[[], Worker], workers: int) -> None:
        """Prepare the processes.

        Args:
            make: Makes a worker in its process; it is pickled.
            workers: Number of processes.
        """
        context = get_context("spawn")  # a fork would copy threads and GL contexts in unknown states
        self._workers = workers
        self._pool = ProcessPoolExecutor(workers, context, initializer=_start, initargs=(make, os.getpid()))

    def map(self, numbers: Iterator[int]) -> Iterator[Any]:
        """Have the workers answer numbers, and yield the answers as they come.

        A number is taken when a worker is free for it.

        Raises:
            RcsError: A worker died.
            Exception: What a worker raised.
        """
        pending: set[Future[Any]] = set()
        try:
            while True:
                pending |= {self._pool.submit(_attempt, n) for n in islice(numbers, self._workers - len(pending))}
                if not pending:
                    return
                done, pending = wait(pending, return_when=FIRST_COMPLETED)
                for future in done:
                    yield future.result()
        except BrokenProcessPool as err:
            raise RcsError("A worker process died (was it killed, or out of memory?); resume to go on.") from err

    def close(self) -> None:
        """Let the workers finish what they have at work, then end them. Closing twice is harmless."""
        self._pool.shutdown(cancel_futures=True)

    def __enter__(self) -> Self:
        """Return the pool."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the pool."""
        self.close()


class _Process:
    """What a worker process has: how to make its worker, and that once it is made."""

    make: list[Callable[[], Worker]]
    worker: Worker


def _start(make: Callable[[], Worker], parent: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _die_with(parent)
    # One process per core is what the pool is for; Mesa's own threads would only get in the way.
    os.environ["LP_NUM_THREADS"] = "1"
    _Process.make = [make]


def _attempt(number: int) -> Any:
    if _Process.make:  # only now, so that what goes wrong reaches the parent
        _Process.worker = _Process.make[0]()
        _Process.make = []
        atexit.register(_Process.worker.close)
    return _Process.worker.attempt(number)


def _die_with(parent: int) -> None:
    """Have the system kill this process when its parent dies, on Linux."""
    if sys.platform != "linux":
        return
    import ctypes

    pr_set_pdeathsig = 1  # linux/prctl.h
    ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)
    if os.getppid() != parent:  # it died in between
        os._exit(1)
