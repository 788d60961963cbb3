"""A thread beside a loop, which hands items over and never waits for them."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

_log = logging.getLogger(__name__)

Item = TypeVar("Item")


class BackgroundThread(Generic[Item]):
    """Handles items one after the other on a thread of its own, which starts with the first item.

    An exception in the handler is logged, kept in `error`, and ends the work.
    """

    def __init__(self, name: str, handle: Callable[[Item], None]) -> None:
        """Start nothing yet.

        Args:
            name: Name of the thread.
            handle: Handles one item; called from the thread alone.
        """
        self.waiting: deque[Item] = deque()
        """The items that wait, oldest first; change them under `changed` alone."""
        self.changed = threading.Condition()
        """Guards `waiting` and is notified of every change; it may also guard the results of the handler."""
        self.error: Exception | None = None
        """The exception that ended the work."""
        self._name = name
        self._handle = handle
        self._is_busy = self._is_ending = False
        self._thread: threading.Thread | None = None

    @property
    def is_current(self) -> bool:
        """Whether the calling thread is this one."""
        return threading.current_thread() is self._thread

    def put(self, item: Item) -> None:
        """Hand over an item; nothing happens after an error or `close`."""
        with self.changed:
            if self.error is not None or self._is_ending:
                return
            self.waiting.append(item)
            self.changed.notify_all()
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
                self._thread.start()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until all items are handled, at most for a time [s]; return whether they are."""
        with self.changed:
            self.changed.wait_for(lambda: self._is_ending or not (self.waiting or self._is_busy), timeout)
            return not (self.waiting or self._is_busy)

    def close(self, timeout: float | None = None) -> bool:
        """Drop the items that wait and end the thread; return whether it has ended. Closing twice is harmless.

        Args:
            timeout: Longest time to wait for the item that is being handled [s]; None for no limit. A thread that takes
                longer is left behind.
        """
        with self.changed:
            self._is_ending = True
            self.waiting.clear()
            self.changed.notify_all()
        if self._thread is None:
            return True
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while self.error is None:
            with self.changed:
                self.changed.wait_for(lambda: self.waiting or self._is_ending)
                if self._is_ending:
                    return
                item = self.waiting.popleft()
                self._is_busy = True
            try:
                self._handle(item)
            except Exception as err:  # noqa: BLE001  a thread has no caller; the owner looks at `error`
                _log.exception("The thread %r has failed and handles nothing more.", self._name)
                self.error = err
            with self.changed:
                self._is_busy = False
                if self.error is not None:
                    self.waiting.clear()
                self.changed.notify_all()
