"""A connection that several devices share, such as an arm and the gripper at its wrist."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType
from typing import Generic, TypeVar

from rcs.devices import Device
from rcs.errors import WrongOrder

Connection = TypeVar("Connection")


class Link(Generic[Connection]):
    """A connection that the first device opens and the last one closes, used by one thread at a time.

    A device calls `open` in its `_open`, `close` in its `_close`, and in between:

        with self._link as connection:
            joints = connection.ask("joints")

    A stop must not wait for a call in progress: if the vendor's library allows it, let `_hold` use a connection of its
    own.
    """

    def __init__(self, connect: Callable[[], Connection], disconnect: Callable[[Connection], None]) -> None:
        """Store the functions; nothing is connected yet.

        Args:
            connect: Opens and returns the connection; `open` passes on its exceptions.
            disconnect: Closes it.
        """
        self._connect = connect
        self._disconnect = disconnect
        self._users: set[Device] = set()
        self._connection: Connection | None = None
        self._lock = threading.RLock()

    def open(self, device: Device) -> None:
        """Connect for a device unless another one has already done so."""
        with self._lock:
            if not self._users:
                self._connection = self._connect()
            self._users.add(device)

    def close(self, device: Device) -> None:
        """Disconnect if no other device needs the connection; ignore a device that has not opened it."""
        with self._lock:
            if device not in self._users:
                return
            self._users.remove(device)
            if not self._users and self._connection is not None:
                connection, self._connection = self._connection, None
                self._disconnect(connection)

    def __enter__(self) -> Connection:
        """Wait until no other thread uses the connection, and return it.

        Raises:
            WrongOrder: No device has opened it.
        """
        self._lock.acquire()
        if self._connection is None:
            self._lock.release()
            raise WrongOrder("The link is used before a device has opened it; call link.open(self) in _open.")
        return self._connection

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """Let other threads use the connection."""
        self._lock.release()
