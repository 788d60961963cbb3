"""A worker handles what it is given in order, and a loop never waits for it."""

from __future__ import annotations

import threading

from rcs.worker import Worker


def test_items_are_handled_in_their_order() -> None:
    handled: list[int] = []
    worker = Worker("a test", handled.append)
    for item in range(100):
        worker.put(item)
    assert worker.wait(5.0)
    assert handled == list(range(100))
    assert worker.close()
    assert worker.close()


def test_an_error_ends_the_work_and_is_kept() -> None:
    def fail(item: int) -> None:
        raise ValueError(item)

    worker = Worker("a test", fail)
    worker.put(1)
    assert worker.wait(5.0)
    worker.put(2)
    assert str(worker.error) == "1"
    assert not worker.waiting
    assert worker.close(5.0)


def test_a_handler_that_does_not_return_is_left_behind() -> None:
    gate = threading.Event()
    handled: list[int] = []

    def block(item: int) -> None:
        gate.wait()
        handled.append(item)

    worker = Worker("a test", block)
    worker.put(1)
    worker.put(2)
    assert not worker.wait(0.05)
    assert not worker.close(0.05)
    gate.set()
    assert worker.close(5.0)
    assert handled == [1]
