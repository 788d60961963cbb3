"""A port of a Franka controller, which serves one client: requests by TCP, states and commands by UDP."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from rcs.virtual.line import Line
from rcs.virtual.wire import taken

MOST_BYTES = 4096
"""Maximum length of a message; longer ones are invalid."""
LEAST_TIME = 0.5e-3
"""Minimum time that a client has to answer a state [s]; within it, a missing answer does not count, since a delayed
virtual arm sends several states in a row to catch up."""


class Client:
    """The client of a port."""

    def __init__(self, connected: socket.socket, line: Line, header: np.dtype[np.void]) -> None:
        """Use an accepted connection."""
        connected.setblocking(False)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.tcp = connected
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        own, peer = connected.getsockname(), connected.getpeername()
        self.udp.bind((own[0], 0))
        self.sent = 0
        """Number of the last state."""
        self.received = bytearray()
        self._line, self._header, self._host = line, header, peer[0]
        self._port = 0
        self._sent_at = 0.0
        self._datagram: bytes | None = None

    @property
    def is_connected(self) -> bool:
        """True after the client has sent its connect request."""
        return self._port != 0

    @property
    def had_time(self) -> bool:
        """True if the client has had time to answer the last state."""
        return time.monotonic() - self._sent_at >= LEAST_TIME

    def connect(self, port: int) -> None:
        """Set the UDP port of the client's states."""
        self._port = port

    def reply(self, command: int, number: int, content: bytes) -> None:
        """Answer a request."""
        header = np.array((command, number, self._header.itemsize + len(content)), self._header)
        try:
            self.tcp.sendall(header.tobytes() + content)
        except OSError:  # the client is gone or does not read; reading its socket reveals it
            return

    def send_datagram(self, state: bytes) -> None:
        """Send a state; one that is damaged on its way is dropped, as UDP's checksum does."""
        self._sent_at = time.monotonic()
        self._line.send(state, lambda passed: self._send_datagram(passed) if passed == state else None)

    def read_datagrams(self) -> None:
        """Read commands and keep the newest that is not damaged."""
        while True:
            try:
                datagram = self.udp.recv(MOST_BYTES)
            except (BlockingIOError, ConnectionRefusedError):
                return
            if self._line.receive(datagram) == datagram:
                self._datagram = datagram

    def take_datagram(self) -> bytes | None:
        """Return the newest command since the last call, if any."""
        self.read_datagrams()
        datagram, self._datagram = self._datagram, None
        return datagram

    def close(self) -> None:
        """Disconnect."""
        self.tcp.close()
        self.udp.close()

    def _send_datagram(self, state: bytes) -> None:
        try:
            self.udp.sendto(state, (self._host, self._port))
        except OSError:  # the client is gone
            return


class Listener:
    """Listens for a client. While one is connected, others wait."""

    def __init__(
        self, line: Line, address: str, port: int, header: np.dtype[np.void], requests: Mapping[int, np.dtype[np.void]]
    ) -> None:
        """Listen.

        Args:
            line: Line that all packets pass.
            address: An IP address of this machine.
            port: TCP port.
            header: Type of the header of every message.
            requests: Types of the content after the header, by command.

        Raises:
            InvalidSetup: The port is taken.
        """
        self.client: Client | None = None
        self._line, self._header, self._requests = line, header, requests
        try:
            self._socket = socket.create_server((address, port))
        except OSError as err:
            raise taken(f"Port {port} of a virtual Franka robot", address, err) from err
        self._socket.setblocking(False)

    def files(self) -> Sequence[socket.socket]:
        """Return the sockets to read from."""
        if self._line.is_cut:
            return []
        return [self._socket] if self.client is None else [self.client.tcp, self.client.udp]

    def receive(self, file: socket.socket, command: np.dtype[np.void] | None = None) -> Iterator[tuple[int, int, Any]]:
        """Read from a socket and yield complete requests as (command, number, content)."""
        client = self.client
        if file is self._socket:
            self.client = Client(self._socket.accept()[0], self._line, self._header)
        elif client is not None and file is client.udp:
            client.read_datagrams()
        elif client is not None and file is client.tcp:
            try:
                data = client.tcp.recv(MOST_BYTES)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if not data:
                self.hang_up()
                return
            client.received += data  # TCP repeats lost packets
            yield from self._requests_of(client)

    def hang_up(self) -> None:
        """End the connection to the client, if there is one."""
        if self.client is not None:
            self.client.close()
            self.client = None

    def close(self) -> None:
        """Stop listening; closing twice is harmless."""
        self.hang_up()
        self._socket.close()

    def _requests_of(self, client: Client) -> Iterator[tuple[int, int, Any]]:
        size = self._header.itemsize
        while len(client.received) >= size:
            header = np.frombuffer(bytes(client.received[:size]), self._header)[0]
            length, kind = int(header["size"]), self._requests.get(int(header["command"]))
            wanted = size + (0 if kind is None else kind.itemsize)
            if length != wanted:  # another protocol: a real controller ends the connection
                self.hang_up()
                return
            if len(client.received) < length:
                return
            content = bytes(client.received[size:length])
            del client.received[:length]
            yield int(header["command"]), int(header["id"]), None if kind is None else np.frombuffer(content, kind)[0]
