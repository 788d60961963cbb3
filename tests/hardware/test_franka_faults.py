"""Calls of Franka's library, which end a connection by letting go of it."""

from __future__ import annotations

import gc
import time
import weakref

import pytest

from rcs.hardware.franka_faults import within


class Connection:
    def fail(self) -> None:
        raise ValueError("rejected")


def test_an_exception_of_a_call_does_not_keep_the_connection() -> None:
    connection = Connection()
    alive = weakref.ref(connection)
    gc.disable()
    try:
        with pytest.raises(ValueError, match="rejected") as kept:
            within(5.0, connection.fail)
        del connection
        assert alive() is None
        assert kept.value.__traceback__ is not None, "the exception is kept"
    finally:
        gc.enable()


def test_a_call_that_does_not_return_in_time_is_left_behind() -> None:
    assert within(5.0, lambda: 3) == 3
    with pytest.raises(TimeoutError):
        within(0.01, lambda: time.sleep(0.2))
