"""Messages over a socket: TCP, TLS, or a Unix socket.

A frame is 16 bytes, `VLA1`, the header's length (4 bytes, little-endian) and the body's (8), then header and body.
Lengths are compared with what is allowed before anything is allocated.
"""

from __future__ import annotations

import struct
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlagents.errors import BadMessage
from vlagents.wire.link import AHEAD, LARGEST_BODY, Channel, Deadline, Link
from vlagents.wire.message import pack, unpack

MAGIC = b"VLA1"
PREFIX = struct.Struct("<4sIQ")
LARGEST_HEADER = 256 << 10
"""Most bytes of a header, and on other wires of what is no large array."""
KEPT = 64 << 20
"""Memory of a body of up to this many bytes is used again: new memory costs more time than reading into it."""


class StreamChannel(Channel):
    """Messages over a connected socket; the largest one is that of its arrays."""

    def __init__(self, link: Link, *, largest: int = LARGEST_BODY) -> None:
        """Take over a link, as `Channel` does."""
        super().__init__(link, largest=largest)
        self._body = np.empty(0, np.uint8)

    def send(self, values: Any, deadline: Deadline) -> None:
        """Send a message.

        Raises:
            InvalidInput: It does not travel; nothing was sent.
            DeadlineExceeded: The other side does not read.
            ConnectionLost: It has gone.
        """
        header, parts, size = pack(values)
        if len(header) > LARGEST_HEADER:
            raise BadMessage(f"A header of {len(header)} bytes is too large; valid are up to {LARGEST_HEADER}.")
        with self.guarded():
            self._send(header, parts, size, deadline)

    def wait(self, seconds: float | None) -> bool:
        """Wait until a message begins to come or the connection ends; return whether it did in that time [s]."""
        return self._link.wait(seconds)

    def settled(self) -> None:
        """Say that every message which was sent has been read: there is an answer to each."""

    def _send(self, header: bytes, parts: list[memoryview], size: int, deadline: Deadline) -> None:
        prefix = PREFIX.pack(MAGIC, len(header), size)
        self._link.send([memoryview(prefix + header), *parts], deadline)

    def _receive(self, deadline: Deadline, begun: Deadline | None) -> Any:
        rest = self._begun(deadline, begun)
        return self._receive_body(self._link.take(PREFIX.size, rest), rest)

    def _receive_body(self, prefix: bytes, rest: Deadline) -> Any:
        magic, header_size, size = PREFIX.unpack(prefix)
        if magic == b"HTTP":
            raise BadMessage(
                "The other side speaks HTTP. If it serves a websocket, its address begins with ws:// or wss://."
            )
        if magic != MAGIC:
            raise BadMessage(f"A message begins with {magic!r}; valid is {MAGIC!r}.")
        self._check_sizes(header_size, size)
        header = self._header(header_size, rest)
        body = self._room(size)
        self._link.fill(body.data, rest)
        return unpack(header, body)

    def _room(self, size: int) -> NDArray[np.uint8]:
        """Return memory for a body: that of the last one again, unless an array of it is in use."""
        if size > KEPT:
            return np.empty(size, np.uint8)
        if len(self._body) < size or sys.getrefcount(self._body) > 2:
            self._body = np.empty(size, np.uint8)
        return self._body[:size]

    def _check_sizes(self, header_size: int, size: int) -> None:
        largest_header = min(LARGEST_HEADER, self.largest)
        if header_size > largest_header or size > self.largest:
            raise BadMessage(
                f"A message of {header_size} and {size} bytes is too large; valid are up to {largest_header} and "
                f"{self.largest}."
            )

    def _header(self, size: int, rest: Deadline) -> bytes | bytearray:
        if size <= AHEAD:
            return self._link.take(size, rest)
        header = bytearray(size)
        self._link.fill(memoryview(header), rest)
        return header

    def _fail(self) -> None:
        self.close()
