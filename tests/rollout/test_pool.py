"""Worker processes answer, and what goes wrong in one reaches the caller."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from rcs.errors import InvalidSetup, RcsError
from rcs.rollout.pool import WorkerPool


@dataclass(frozen=True)
class Sleeper:
    """Makes a worker that is killed by 1, and needs half a minute for anything else."""

    def __call__(self) -> Sleeper:
        return self

    def attempt(self, number: int) -> int:
        if number == 1:
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(30.0)
        return number

    def close(self) -> None:
        """Nothing to release."""


@dataclass(frozen=True)
class Squares:
    """Makes a worker, at module level so that it can be sent to a process; it leaves a file when it is closed."""

    folder: Path
    fails_to_start: bool = False

    def __call__(self) -> Squares:
        if self.fails_to_start:
            raise InvalidSetup("no such robot")
        return self

    def attempt(self, number: int) -> int:
        if number < 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return number * number

    def close(self) -> None:
        (self.folder / str(os.getpid())).touch()


def test_every_number_is_answered_and_workers_are_closed_in_the_end(tmp_path: Path) -> None:
    with WorkerPool(Squares(tmp_path), 2) as pool:
        assert sorted(pool.map(iter(range(9)))) == [n * n for n in range(9)]
        pool.close()
    assert 1 <= len(list(tmp_path.iterdir())) <= 2


def test_numbers_are_taken_only_when_a_worker_is_free(tmp_path: Path) -> None:
    taken: list[int] = []

    def numbers() -> Iterator[int]:
        for number in range(100):
            taken.append(number)
            yield number

    with WorkerPool(Squares(tmp_path), 2) as pool:
        answers = pool.map(numbers())
        next(answers)
        assert len(taken) == 2


def test_a_worker_that_cannot_be_made_says_why(tmp_path: Path) -> None:
    with WorkerPool(Squares(tmp_path, fails_to_start=True), 2) as pool, pytest.raises(InvalidSetup, match="no such"):
        list(pool.map(iter(range(3))))


def test_a_worker_that_dies_ends_the_work_with_an_error(tmp_path: Path) -> None:
    with WorkerPool(Squares(tmp_path), 2) as pool, pytest.raises(RcsError, match="died"):
        list(pool.map(iter([1, -1, 2, 3])))


def test_a_death_is_noticed_while_the_other_workers_are_still_at_work(monkeypatch: pytest.MonkeyPatch) -> None:
    began = time.monotonic()
    with WorkerPool(Sleeper(), 2) as pool:
        # The executor waits for the deaths of those processes that it had when it began to wait: without the second.
        start = pool._pool._adjust_process_count
        monkeypatch.setattr(pool._pool, "_adjust_process_count", lambda: (time.sleep(0.3), start()))
        with pytest.raises(RcsError, match=r"died.*resume"):
            list(pool.map(iter([0, 1])))
    assert time.monotonic() - began < 25.0


def test_ctrl_c_that_reaches_the_pool_ends_it_at_once() -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    began = time.monotonic()
    timer = threading.Timer(5.0, os.kill, (os.getpid(), signal.SIGINT))  # as a rule, workers are at work by then
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt), WorkerPool(Sleeper(), 2) as pool:
            list(pool.map(iter([0, 2])))
    finally:
        timer.cancel()
        signal.signal(signal.SIGINT, before)
    assert time.monotonic() - began < 15.0
