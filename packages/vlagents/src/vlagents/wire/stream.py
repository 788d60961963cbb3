"""Messages over a socket: TCP, TLS, or a Unix socket.

A frame is 16 bytes, `VLA1`, the header's length (4 bytes, little-endian) and the body's (8), then header and body.
Lengths are compared with what is allowed before anything is allocated.
"""

from __future__ import annotations

import contextlib
import select
import socket
import ssl
import struct
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from vlagents.errors import BadMessage, ConnectionLost, VlagentsError
from vlagents.wire.deadline import Deadline
from vlagents.wire.message import pack, unpack

MAGIC = b"VLA1"
PREFIX = struct.Struct("<4sIQ")
LARGEST_HEADER = 1 << 20
"""Most bytes of a header."""
LARGEST_BODY = 256 << 20
"""Most bytes of a body, by default: forty full HD pictures."""
MOST_PARTS = 512
"""Most buffers in one call of the system."""


class Channel(Protocol):
    """Carries messages both ways."""

    def send(self, values: Any, deadline: Deadline) -> None:
        """Send a message."""
        ...

    def receive(self, deadline: Deadline, begun: Deadline | None = None) -> Any:
        """Return the next message."""
        ...

    def close(self) -> None:
        """End the connection; the other side learns it."""
        ...


class StreamChannel:
    """Messages over a connected socket. After any error but an `InvalidInput` it is closed, for it is out of step."""

    def __init__(self, connection: socket.socket, *, largest_body: int = LARGEST_BODY) -> None:
        """Take over a socket.

        Args:
            connection: It is closed with the channel.
            largest_body: Most bytes of arrays in a message that comes.
        """
        self._socket = connection
        self.largest_body = largest_body
        with contextlib.suppress(OSError):
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def send(self, values: Any, deadline: Deadline) -> None:
        """Send a message.

        Raises:
            InvalidInput: It does not travel; nothing was sent.
            DeadlineExceeded: The other side does not read.
            ConnectionLost: It has gone.
        """
        header, parts, size = pack(values)
        self._check_header(header)
        self._guarded(self._send_inline, header, parts, size, deadline)

    def receive(self, deadline: Deadline, begun: Deadline | None = None) -> Any:
        """Return the next message.

        Args:
            deadline: By when it must have begun to come, and be complete unless `begun` says otherwise.
            begun: By when it must be complete once it began, counted from then.

        Raises:
            DeadlineExceeded: It did not come in time.
            BadMessage: It is none, or too large.
            ConnectionLost: The other side has gone.
        """
        return self._guarded(self._receive, deadline, begun)

    def wait(self, seconds: float | None) -> bool:
        """Wait until a message begins to come or the connection ends; return whether it did in that time [s]."""
        if isinstance(self._socket, ssl.SSLSocket) and self._socket.pending():
            return True
        return bool(select.select([self._socket], [], [], seconds)[0])

    def close(self) -> None:
        """Close the socket."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def _send_inline(self, header: bytes, parts: list[memoryview], size: int, deadline: Deadline) -> None:
        prefix = PREFIX.pack(MAGIC, len(header), size)
        self._send_all([memoryview(prefix + header), *parts], deadline)

    def _check_header(self, header: bytes) -> None:
        if len(header) > LARGEST_HEADER:
            raise BadMessage(f"A header of {len(header)} bytes is too large; valid are up to {LARGEST_HEADER}.")

    def _receive(self, deadline: Deadline, begun: Deadline | None) -> Any:
        prefix = bytearray(PREFIX.size)
        self._fill(memoryview(prefix)[:1], deadline)
        rest = deadline if begun is None else Deadline(begun.seconds, "the rest of a message")
        self._fill(memoryview(prefix)[1:], rest)
        return self._receive_body(prefix, rest)

    def _receive_body(self, prefix: bytearray, rest: Deadline) -> Any:
        magic, header_size, body_size = PREFIX.unpack(prefix)
        if magic != MAGIC:
            raise BadMessage(f"A message begins with {bytes(magic)!r}; valid is {MAGIC!r}.")
        if header_size > LARGEST_HEADER or body_size > self.largest_body:
            raise BadMessage(
                f"A message of {header_size} and {body_size} bytes is too large; valid are up to {LARGEST_HEADER} and "
                f"{self.largest_body}."
            )
        header = bytearray(header_size)
        self._fill(memoryview(header), rest)
        body = np.empty(body_size, np.uint8)
        self._fill(body.data, rest)
        return unpack(bytes(header), body)

    def _fill(self, view: memoryview, deadline: Deadline) -> None:
        while view:
            self._socket.settimeout(deadline.left())
            try:
                count = self._socket.recv_into(view)
            except TimeoutError as error:
                raise deadline.exceeded() from error
            if not count:
                raise ConnectionLost("The other side has closed the connection.")
            view = view[count:]

    def _send_all(self, parts: Sequence[memoryview], deadline: Deadline) -> None:
        waiting = list(parts)
        while waiting:
            self._socket.settimeout(deadline.left())
            try:
                count = self._send_some(waiting[:MOST_PARTS])
            except TimeoutError as error:
                raise deadline.exceeded() from error
            while waiting and count >= len(waiting[0]):
                count -= len(waiting.pop(0))
            if count:
                waiting[0] = waiting[0][count:]

    def _send_some(self, parts: Sequence[memoryview]) -> int:
        if isinstance(self._socket, ssl.SSLSocket):  # TLS takes one buffer at a time
            return self._socket.send(parts[0])
        return self._socket.sendmsg(parts)

    def _guarded(self, act: Callable[..., Any], *given: Any) -> Any:
        """Do something with the socket; whatever goes wrong closes it, with an error of ours."""
        try:
            return act(*given)
        except VlagentsError:
            self.close()
            raise
        except OSError as error:
            self.close()
            raise ConnectionLost(f"The connection broke: {error}.") from error
