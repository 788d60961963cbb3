"""A thread handles what it is given in order, and a loop never waits for it."""

from __future__ import annotations

import threading

from rcs.background_thread import BackgroundThread


def test_items_are_handled_in_their_order() -> None:
    handled: list[int] = []
    thread = BackgroundThread("a test", handled.append)
    for item in range(100):
        thread.put(item)
    assert thread.wait(5.0)
    assert handled == list(range(100))
    assert thread.close()
    assert thread.close()


def test_an_error_ends_the_work_and_is_kept() -> None:
    def fail(item: int) -> None:
        raise ValueError(item)

    thread = BackgroundThread("a test", fail)
    thread.put(1)
    assert thread.wait(5.0)
    thread.put(2)
    assert str(thread.error) == "1"
    assert not thread.waiting
    assert thread.close(5.0)


def test_a_handler_that_does_not_return_is_left_behind() -> None:
    gate = threading.Event()
    handled: list[int] = []

    def block(item: int) -> None:
        gate.wait()
        handled.append(item)

    thread = BackgroundThread("a test", block)
    thread.put(1)
    thread.put(2)
    assert not thread.wait(0.05)
    assert not thread.close(0.05)
    gate.set()
    assert thread.close(5.0)
    assert handled == [1]
