"""Worker processes that each make one thing and then answer numbers with results.

Workers die with their parent (Linux tells them; elsewhere they see their pipe end), so that no writer outlives the lock
on its dataset. Ctrl-C is the parent's business: workers finish what they have at work.
"""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Any, Protocol, Self

from rcs.errors import RcsError

STOP_TIME = 30.0
"""How long a worker may take to end [s] before it is killed; an episode takes seconds."""


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
        """Start the processes.

        Args:
            make: Makes a worker in its process; it is pickled.
            workers: Number of processes.
        """
        context = multiprocessing.get_context("spawn")  # a fork would copy threads and GL contexts in unknown states
        self._processes: list[Any] = []
        self._pipes: list[Any] = []  # connections; their class depends on the platform
        for i in range(workers):
            here, there = context.Pipe()
            process = context.Process(
                target=_serve, args=(make, there, os.getpid()), name=f"rcs worker {i}", daemon=True
            )
            process.start()
            there.close()
            self._processes.append(process)
            self._pipes.append(here)

    def map(self, numbers: Iterator[int]) -> Iterator[Any]:
        """Have the workers answer numbers, and yield the answers as they come.

        Raises:
            RcsError: A worker failed or died; its message or traceback is in the error.
        """
        busy: set[multiprocessing.connection.Connection] = set()
        for pipe in self._pipes:
            self._send_next(pipe, numbers, busy)
        while busy:
            for ready in multiprocessing.connection.wait(list(busy)):
                assert isinstance(ready, multiprocessing.connection.Connection)
                try:
                    is_answer, value = ready.recv()
                except EOFError as err:
                    raise RcsError(
                        "A worker process died (was it killed, or out of memory?); resume to go on."
                    ) from err
                busy.discard(ready)
                if not is_answer:
                    raise value
                self._send_next(ready, numbers, busy)
                yield value

    def _send_next(
        self,
        pipe: multiprocessing.connection.Connection,
        numbers: Iterator[int],
        busy: set[multiprocessing.connection.Connection],
    ) -> None:
        number = next(numbers, None)
        if number is not None:
            try:
                pipe.send(number)
            except (BrokenPipeError, ConnectionResetError) as err:
                raise RcsError("A worker process died before it had work; see its message above.") from err
            busy.add(pipe)

    def close(self) -> None:
        """Let the workers finish what they have at work, then end them. Closing twice is harmless."""
        for pipe in self._pipes:
            pipe.close()
        for process in self._processes:
            process.join(STOP_TIME)
            if process.is_alive():
                process.kill()
                process.join()
        self._pipes, self._processes = [], []

    def __enter__(self) -> Self:
        """Return the pool."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the pool."""
        self.close()


def _serve(make: Callable[[], Worker], pipe: multiprocessing.connection.Connection, parent: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _die_with(parent)
    # One process per core is what the pool is for; Mesa's own threads would only get in the way.
    os.environ["LP_NUM_THREADS"] = "1"
    try:
        worker = make()
    except Exception as err:  # noqa: BLE001  whatever it is, the parent raises it
        _tell(pipe, (False, _portable(err)))
        return
    try:
        while True:
            try:
                number = pipe.recv()
            except (EOFError, ConnectionResetError):
                return
            try:
                answer = (True, worker.attempt(number))
            except Exception as err:  # noqa: BLE001  whatever it is, the parent raises it
                answer = (False, _portable(err))
            if not _tell(pipe, answer):
                return
    finally:
        worker.close()


def _tell(pipe: multiprocessing.connection.Connection, answer: tuple[bool, Any]) -> bool:
    try:
        pipe.send(answer)
    except (BrokenPipeError, ConnectionResetError):
        return False  # the parent has closed the pool and waits for this process to end
    return True


def _portable(error: Exception) -> RcsError:
    """Return an error that can be sent: known ones as they are, others as their traceback."""
    if type(error).__module__ == RcsError.__module__:
        return error  # pyright: ignore[reportReturnType]
    return RcsError("A worker failed:\n" + "".join(traceback.format_exception(error)))


def _die_with(parent: int) -> None:
    """Have the system kill this process when its parent dies, on Linux."""
    if sys.platform != "linux":
        return
    import ctypes

    pr_set_pdeathsig = 1  # linux/prctl.h
    ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)
    if os.getppid() != parent:  # it died in between
        os._exit(1)
