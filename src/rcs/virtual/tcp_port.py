"""A TCP port of a virtual robot that is served from its loop: no call waits."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator

POLLS_PER_ACCEPT = 5
"""New clients are looked for less often than what known ones send: it takes longer."""


class TcpConnection:
    """One client: what it sent and is not yet used, in `received`, and what it has not yet taken."""

    def __init__(self, connected: socket.socket) -> None:
        """Take over a connected socket."""
        connected.setblocking(False)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = connected
        self._waiting = bytearray()
        self.received = bytearray()
        self.is_open = True

    def fileno(self) -> int:
        """Return the number by which the system knows the socket."""
        return self._socket.fileno()

    def send(self, data: bytes) -> None:
        """Send now what the client takes, the rest later."""
        self._waiting += data
        self.flush()

    def flush(self) -> None:
        """Send what the client takes now."""
        if not self._waiting:
            return
        try:
            while self._waiting and self.is_open:
                del self._waiting[: self._socket.send(self._waiting)]
        except BlockingIOError:
            pass
        except OSError:
            self.close()

    def receive(self) -> None:
        """Put what has come into `received`."""
        try:
            while data := self._socket.recv(65536):
                self.received += data
            self.close()
        except BlockingIOError:
            pass
        except OSError:
            self.close()

    def lines(self) -> Iterator[str]:
        """Take whole lines out of what was received."""
        while (end := self.received.find(b"\n")) >= 0:
            line = self.received[:end].decode("utf-8", "replace").strip()
            del self.received[: end + 1]
            yield line

    def close(self) -> None:
        """Hang up."""
        self.is_open = False
        self._socket.close()


class TcpPort:
    """Listens at an address and keeps the connections of its clients."""

    def __init__(self, address: str, port: int) -> None:
        """Listen.

        Raises:
            OSError: The port is in use, or the address is not one of this machine.
        """
        self._listener = socket.create_server((address, port))
        self._listener.setblocking(False)
        self._polls = 0
        self.connections: list[TcpConnection] = []

    def poll(self) -> tuple[list[TcpConnection], list[TcpConnection]]:
        """Receive, and return the connections that are new, and those that have ended."""
        new: list[TcpConnection] = []
        if self._polls % POLLS_PER_ACCEPT == 0:
            with contextlib.suppress(BlockingIOError):
                while True:
                    new.append(TcpConnection(self._listener.accept()[0]))
            self.connections += new
        self._polls += 1
        for connection in self.connections:
            connection.receive()
            connection.flush()
        if all(connection.is_open for connection in self.connections):
            return new, []
        ended = [connection for connection in self.connections if not connection.is_open]
        self.connections = [connection for connection in self.connections if connection.is_open]
        return new, ended

    def close(self) -> None:
        """Hang up on everybody and listen no more."""
        self._listener.close()
        for connection in self.connections:
            connection.close()
        self.connections = []
