"""A non-blocking TCP port of a virtual robot, served from its loop."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator

POLLS_PER_ACCEPT = 5
"""Number of polls for data per poll for new clients, which takes longer."""


class TcpConnection:
    """A client's connection, with its unprocessed input in `received` and a buffer of unsent output."""

    def __init__(self, connected: socket.socket) -> None:
        """Use an accepted socket."""
        connected.setblocking(False)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = connected
        self._waiting = bytearray()
        self.received = bytearray()
        self.is_open = True

    def fileno(self) -> int:
        """Return the file descriptor of the socket."""
        return self._socket.fileno()

    def send(self, data: bytes) -> None:
        """Send as much as the client accepts now, and the rest later."""
        self._waiting += data
        self.flush()

    def flush(self) -> None:
        """Send as much of the unsent data as the client accepts now."""
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
        """Append pending input to `received`."""
        try:
            while data := self._socket.recv(65536):
                self.received += data
            self.close()
        except BlockingIOError:
            pass
        except OSError:
            self.close()

    def lines(self) -> Iterator[str]:
        """Yield complete lines and remove them from `received`."""
        while (end := self.received.find(b"\n")) >= 0:
            line = self.received[:end].decode("utf-8", "replace").strip()
            del self.received[: end + 1]
            yield line

    def close(self) -> None:
        """Disconnect."""
        self.is_open = False
        self._socket.close()


class TcpPort:
    """A listening socket with the connections of its clients."""

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
        """Receive data, and return the new connections and those that have ended."""
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
        """Disconnect all clients and stop listening."""
        self._listener.close()
        for connection in self.connections:
            connection.close()
        self.connections = []
