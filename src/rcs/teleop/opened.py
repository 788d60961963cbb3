"""The connection that a device has open: one thread reads it, and any thread may close it."""

from __future__ import annotations

import threading
from typing import Generic, Protocol, TypeVar

from rcs.errors import DeviceFault


class Closable(Protocol):
    """A file, a port or the like."""

    def close(self) -> None:
        """Give it back."""
        ...


Resource = TypeVar("Resource", bound=Closable)


class Opened(Generic[Resource]):
    """Holds an open resource; `with` blocks use it, one at a time."""

    def __init__(self, what: str) -> None:
        """Hold nothing.

        Args:
            what: The device in messages.
        """
        self._what = what
        self._lock = threading.Lock()
        self._resource: Resource | None = None
        self._must_close = False

    def put(self, resource: Resource) -> None:
        """Hold a resource in place of the last one, which is closed."""
        self.close()
        self._resource, self._must_close = resource, False

    def __enter__(self) -> Resource:
        """Use the resource.

        Raises:
            DeviceFault: There is none.
        """
        self._lock.acquire()
        if self._resource is None or self._must_close:
            self._lock.release()
            raise DeviceFault(f"The {self._what} is closed; open it first.")
        return self._resource

    def __exit__(self, *_: object) -> None:
        """Let other threads have it."""
        self._lock.release()

    def close(self) -> None:
        """Close the resource as soon as nobody uses it; closing twice is harmless."""
        self._must_close = True  # a thread that reads again and again would not let go of the lock
        with self._lock:
            if self._resource is not None:
                resource, self._resource = self._resource, None
                resource.close()
