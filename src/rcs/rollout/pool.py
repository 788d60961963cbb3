"""A pool of worker processes, each with its own worker object that maps numbers to results.

Workers die with their parent, so that no writer outlives the lock on its dataset. Only the parent handles Ctrl-C:
workers finish their present number, unless it ends the pool.
"""

from __future__ import annotations

import atexit
import os
import signal
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from multiprocessing import active_children, get_context, resource_tracker
from multiprocessing.process import BaseProcess
from typing import Any, Protocol

from rcs_data.files.closing import Closing

from rcs.errors import RcsError

_WATCH = 1.0
"""Time between two looks for workers that have died [s]: the executor may not hear of it before another one answers."""


class Worker(Protocol):
    """The object that a worker process makes and uses."""

    def attempt(self, number: int) -> Any:
        """Return the result for a number."""
        ...

    def close(self) -> None:
        """Release all resources."""
        ...


class WorkerPool(Closing):
    """Processes that map numbers to results, in order of completion."""

    def __init__(self, make: Callable[[], Worker], workers: int) -> None:
        """Prepare the processes.

        Args:
            make: Makes a worker in its process; it is pickled.
            workers: Number of processes.
        """
        context = get_context("spawn")  # a fork would copy threads and GL contexts in undefined states
        self._workers = workers
        self._others, self._own = set(active_children()), set[BaseProcess]()
        self._pool = ProcessPoolExecutor(workers, context, initializer=_start, initargs=(make, os.getpid()))

    def map(self, numbers: Iterator[int]) -> Iterator[Any]:
        """Map numbers to results, and yield these in order of completion.

        A number is taken when a worker is free.

        Raises:
            RcsError: A worker died.
            Exception: A worker raised it.
        """
        pending: set[Future[Any]] = set()
        try:
            while True:
                wanted = list(islice(numbers, self._workers - len(pending)))
                with _without_interrupts():
                    pending |= {self._pool.submit(_attempt, number) for number in wanted}
                    self._own |= set(active_children()) - self._others
                if not pending:
                    return
                done, pending = wait(pending, _WATCH, return_when=FIRST_COMPLETED)
                for future in done:
                    yield future.result()
                if not done and not self._own <= set(active_children()):
                    raise BrokenProcessPool
        except BrokenProcessPool as err:
            # One that died while it took a number keeps a lock, on which the others, and the pool's end, would wait.
            self._kill()
            raise RcsError("A worker process died (was it killed, or out of memory?); resume to go on.") from err

    def close(self) -> None:
        """Let the workers finish their numbers, then end them. Closing twice is harmless."""
        self._pool.shutdown(cancel_futures=True)

    def __exit__(self, *error: object) -> None:
        """Close it; after Ctrl-C at once, without the numbers that are running."""
        if any(isinstance(one, KeyboardInterrupt) for one in error):
            self._kill()
        self.close()

    def _kill(self) -> None:
        for process in self._own & set(active_children()):
            process.kill()


class _Process:
    """The state of a worker process: how to make its worker, then the worker."""

    make: list[Callable[[], Worker]]
    worker: Worker


@contextmanager
def _without_interrupts() -> Generator[None]:
    """Hold Ctrl-C back while processes are started: they begin with it blocked, until they ignore it themselves."""
    # Python starts this process with the first worker, and then lets Ctrl-C through again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start(make: Callable[[], Worker], parent: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    _die_with(parent)
    # The pool has one process per core; Mesa's own threads would only get in the way.
    os.environ["LP_NUM_THREADS"] = "1"
    _Process.make = [make]


def _attempt(number: int) -> Any:
    if _Process.make:  # only now, so that errors reach the parent
        _Process.worker = _Process.make[0]()
        _Process.make = []
        atexit.register(_Process.worker.close)
    return _Process.worker.attempt(number)


def _die_with(parent: int) -> None:
    """Make Linux kill this process when its parent dies."""
    import ctypes

    pr_set_pdeathsig = 1  # linux/prctl.h
    ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)
    if os.getppid() != parent:  # it died in between
        os._exit(1)
