"""A connected socket with a deadline for every wait, which is read through a buffer.

A small message thus costs one call of the system each way, and what is large goes straight to where it belongs. The
socket never blocks: a call is tried first, and only what cannot go on waits.
"""

from __future__ import annotations

import contextlib
import select
import socket
import ssl
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

from vlagents.address import Address
from vlagents.errors import ConnectionLost, DeadlineExceeded, VlagentsError

AHEAD = 64 << 10
"""Most bytes that are read ahead."""
MOST_PARTS = 512
"""Most buffers in one call of the system."""
STRIDE = 8 << 20
"""Most bytes of one call of the system while a message is read."""
LARGEST_BODY = 256 << 20
"""Most bytes of a message's arrays, by default: forty full HD pictures."""


class Deadline:
    """A moment by which something must be done; every wait on the way gets the time that is left."""

    def __init__(self, seconds: float | None, what: str) -> None:
        """Start.

        Args:
            seconds: How long from now; None for ever.
            what: The event that must happen, for the error: "the server's answer".
        """
        self.seconds = seconds
        self._what = what
        self._end = None if seconds is None else time.monotonic() + seconds

    def left(self) -> float | None:
        """Return how much time is left [s], above 0; None for ever.

        Raises:
            DeadlineExceeded: There is none left.
        """
        if self._end is None:
            return None
        left = self._end - time.monotonic()
        if left <= 0:
            raise self.exceeded()
        return left

    def exceeded(self) -> DeadlineExceeded:
        """Return the error for an event that did not happen in time."""
        return DeadlineExceeded(f"{self._what} did not come within {self.seconds:g} s.")


def dial(address: Address, timeout: float, certificate: str | Path | None = None) -> socket.socket:
    """Return a connection to a server, with TLS where the address's scheme has it.

    Args:
        address: Where the server is.
        timeout: How long each step may take [s].
        certificate: File with the certificate that the server's must be signed by; None for those of the system.

    Raises:
        ConnectionLost: No server is there, or its certificate is not valid.
        DeadlineExceeded: It does not answer.
    """
    connection = None
    try:
        connection = socket.create_connection((address.host, address.port), timeout=timeout)
        if address.scheme in ("vlas", "wss"):
            context = ssl.create_default_context(cafile=None if certificate is None else str(certificate))
            connection = context.wrap_socket(connection, server_hostname=address.host)
    except OSError as error:  # SSLError is one
        if connection is not None:
            connection.close()
        if isinstance(error, TimeoutError):
            raise DeadlineExceeded(f"{address} did not answer within {timeout:g} s.") from error
        what = "No server is" if connection is None else "There is no TLS"
        raise ConnectionLost(f"{what} at {address}: {error}.") from error
    return connection


class Link:
    """Reads and writes a socket. Only one thread reads, and only one writes, at a time."""

    def __init__(self, connection: socket.socket) -> None:
        """Take over a connected socket, of TCP, TLS or Unix; it is closed with the link."""
        connection.setblocking(False)
        self._socket = connection
        self._tls = connection if isinstance(connection, ssl.SSLSocket) else None
        self._ahead = memoryview(bytearray(AHEAD))
        self._start, self._end = 0, 0
        self._to_read, self._to_write = select.poll(), select.poll()
        self._to_read.register(connection, select.POLLIN)
        self._to_write.register(connection, select.POLLOUT)
        if connection.family != socket.AF_UNIX:
            with contextlib.suppress(OSError):
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                # A peer that disappears silently, because its cable was pulled, is noticed after a minute.
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
                for name, value in (("TCP_KEEPIDLE", 30), ("TCP_KEEPINTVL", 10), ("TCP_KEEPCNT", 3)):
                    if hasattr(socket, name):
                        connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)

    @property
    def ahead(self) -> memoryview:
        """Bytes that were read and not taken yet."""
        return self._ahead[self._start : self._end]

    def need(self, count: int, deadline: Deadline) -> memoryview:
        """Return the next `count` bytes, up to `AHEAD` of them, without taking them.

        Raises:
            DeadlineExceeded: They did not arrive in time.
            ConnectionLost: The other side has gone.
        """
        while self._end - self._start < count:
            if self._start + count > AHEAD:
                left = bytes(self.ahead)
                self._start, self._end = 0, len(left)
                self._ahead[: self._end] = left
            self._end += self._read(self._ahead[self._end :], deadline)
        return self._ahead[self._start : self._start + count]

    def skip(self, count: int) -> None:
        """Take bytes that `need` has returned."""
        self._start += count
        if self._start == self._end:
            self._start = self._end = 0

    def take(self, count: int, deadline: Deadline) -> bytes:
        """Return the next `count` bytes, up to `AHEAD` of them."""
        found = bytes(self.need(count, deadline))
        self.skip(count)
        return found

    def fill(self, view: memoryview, deadline: Deadline) -> None:
        """Read until a buffer is full."""
        count = min(len(view), self._end - self._start)
        view[:count] = self._ahead[self._start : self._start + count]
        self.skip(count)
        while count < len(view):
            count += self._read(view[count : count + STRIDE], deadline)

    def peek(self) -> memoryview:
        """Return what is there already, without waiting; nothing if the connection has ended."""
        if self._end < AHEAD:
            with contextlib.suppress(BlockingIOError, ssl.SSLWantReadError, OSError):
                self._end += self._read_now(self._ahead[self._end :])
        return self.ahead

    def send(self, parts: Sequence[memoryview], deadline: Deadline) -> None:
        """Write buffers, one after another.

        Raises:
            DeadlineExceeded: The other side does not read.
            ConnectionLost: It has gone.
        """
        waiting = [part for part in parts if len(part)]
        while waiting:
            if self._tls is None:
                count = self._once_ready(self._to_write, deadline, self._socket.sendmsg, waiting[:MOST_PARTS])
            else:  # one buffer at a time
                count = self._once_ready(self._to_write, deadline, self._tls.send, waiting[0][: 1 << 20])
            while waiting and count >= len(waiting[0]):
                count -= len(waiting.pop(0))
            if count:
                waiting[0] = waiting[0][count:]

    def wait(self, seconds: float | None) -> bool:
        """Wait until something comes or the connection ends; return whether it did in that time [s]."""
        is_here = self._end > self._start or (self._tls is not None and self._tls.pending())
        if is_here or self._socket.fileno() < 0:
            return True
        return bool(self._to_read.poll(None if seconds is None else 1e3 * seconds))

    def stop(self) -> None:
        """End the connection from another thread; the one that reads or writes notices, and closes it."""
        with contextlib.suppress(OSError):
            socket.socket.shutdown(self._socket, socket.SHUT_RDWR)  # of TLS too, whose own forgets the encryption

    def close(self) -> None:
        """Close the socket, whose number may then be another's: only for the thread that reads and writes."""
        self.stop()
        self._socket.close()

    def _read(self, view: memoryview, deadline: Deadline) -> int:
        count = self._once_ready(self._to_read, deadline, self._read_now, view)
        if not count:
            raise ConnectionLost("The other side has closed the connection.")
        return count

    def _read_now(self, view: memoryview) -> int:
        return self._socket.recv_into(view)

    def _once_ready(self, ready: select.poll, deadline: Deadline, act: Callable[..., int], *arguments: Any) -> int:
        """Return the result of a call that reads or writes: it is tried first, and again whenever it can go on."""
        while True:
            try:
                return act(*arguments)
            except BlockingIOError:
                waits = ready
            except ssl.SSLWantReadError:
                waits = self._to_read
            except ssl.SSLWantWriteError:
                waits = self._to_write
            left = deadline.left()
            if not waits.poll(None if left is None else 1e3 * left):
                raise deadline.exceeded()


class Channel(ABC):
    """Messages over a link. After any error but an `InvalidInput` of a message to send it is closed, as out of step."""

    def __init__(self, link: Link, *, largest: int = LARGEST_BODY) -> None:
        """Take over a link.

        Args:
            link: It is closed with the channel.
            largest: Most bytes of a received message.
        """
        self._link = link
        self.largest = largest

    def receive(self, deadline: Deadline, begun: Deadline | None = None) -> Any:
        """Return the next message, in memory of its own.

        Args:
            deadline: By when it must have begun to come, and be complete unless `begun` says otherwise.
            begun: By when it must be complete once it began, counted from then.

        Raises:
            DeadlineExceeded: It did not arrive in time.
            BadMessage: The bytes are no message, or too many.
            ConnectionLost: The other side has gone, or said that it goes.
        """
        with self.guarded():
            return self._receive(deadline, begun)

    def stop(self) -> None:
        """End the connection from another thread; the one that reads or writes notices, and closes it."""
        self._link.stop()

    def close(self) -> None:
        """Close the connection; only for the thread that reads and writes."""
        self._link.close()

    @abstractmethod
    def _receive(self, deadline: Deadline, begun: Deadline | None) -> Any:
        """Return the next message; see `receive`."""

    def _begun(self, deadline: Deadline, begun: Deadline | None) -> Deadline:
        """Wait until a message begins, and return by when it must be complete."""
        self._link.need(1, deadline)
        return deadline if begun is None else Deadline(begun.seconds, "the rest of a message")

    @contextlib.contextmanager
    def guarded(self) -> Generator[None]:
        """Close the link on any error, which becomes one of ours."""
        try:
            yield
        except VlagentsError:
            self._fail()
            raise
        except OSError as error:
            self._fail()
            raise ConnectionLost(f"The connection broke: {error}.") from error

    def _fail(self) -> None:
        """Close after an error."""
        self._link.close()
