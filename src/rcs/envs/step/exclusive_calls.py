"""Allows one call at a time; refuses calls of other threads and nested calls."""

from __future__ import annotations

import threading

from rcs.errors import WrongOrder


class ExclusiveCalls:
    """Calls of an environment: `enter` begins one, and leaving the context ends it.

    Examples:
        >>> calls = ExclusiveCalls()
        >>> with calls.enter("step"):
        ...     pass
    """

    def __init__(self) -> None:
        """Start unused."""
        # Reentrant, to distinguish nested calls from those of another thread.
        self._lock = threading.RLock()
        self._is_taken = False

    def enter(self, call: str) -> ExclusiveCalls:
        """Begin a call, or refuse it.

        Args:
            call: Its name, for the message.

        Raises:
            WrongOrder: Another thread is in a call, or this one already is.
        """
        if not self._lock.acquire(blocking=False):
            raise WrongOrder(f"{call} was called while another thread uses this environment; give each thread its own.")
        if self._is_taken:
            self._lock.release()
            raise WrongOrder(f"{call} was called from inside of a step or reset of the same environment.")
        self._is_taken = True
        return self

    @property
    def is_of_another_thread(self) -> bool:
        """Whether another thread is in a call."""
        if not self._lock.acquire(blocking=False):
            return True
        self._lock.release()
        return False

    def wait(self) -> None:
        """Wait until no other thread is in a call."""
        with self._lock:
            pass

    def __enter__(self) -> None:
        """Continue the call that `enter` began."""

    def __exit__(self, *_: object) -> None:
        """End the call."""
        self._is_taken = False
        self._lock.release()
