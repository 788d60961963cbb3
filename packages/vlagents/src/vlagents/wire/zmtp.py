"""ZeroMQ's requests and replies (ZMTP 3.0, RFC 23 of ZeroMQ), without encryption, over a socket with deadlines.

A message is an empty frame and one with the content. ZeroMQ's own library keeps any number of frames before it hands
out the first, and takes what begins like an HTTP request of a page in a browser for a client of its version 2; here,
sizes are compared with what is allowed before anything is allocated, and what does not begin as it should ends the
connection.
"""

from __future__ import annotations

import struct

import numpy as np

from vlagents.errors import BadMessage
from vlagents.wire.link import LARGEST_BODY, Channel, Deadline, Link

GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x00" + b"NULL".ljust(20, b"\0") + bytes(32)
"""Signature, version 3.0, no encryption, and filling: 64 bytes."""
MORE, LONG, COMMAND = 1, 2, 4
"""Bits of a frame's first byte: another frame follows, the length has 8 bytes, it is no part of a message."""
LARGEST_COMMAND = 255
"""Most bytes of what is no part of a message."""


class ZmtpChannel(Channel):
    """Requests and replies over a link."""

    def __init__(self, link: Link, *, is_client: bool, largest: int = LARGEST_BODY) -> None:
        """Take over a link, which is closed with the channel.

        Args:
            link: To the other side.
            is_client: Whether this side sends requests.
            largest: Most bytes of a received message.
        """
        super().__init__(link, largest=largest)
        self._is_client = is_client

    def greet(self, deadline: Deadline) -> None:
        """Exchange greetings, before all else.

        Raises:
            BadMessage: The other side speaks something else.
            DeadlineExceeded: It says nothing.
            ConnectionLost: It has gone.
        """
        own, theirs = (b"REQ", (b"REP", b"ROUTER")) if self._is_client else (b"ROUTER", (b"REQ", b"DEALER"))
        ready = b"\x05READY\x0bSocket-Type" + struct.pack(">I", len(own)) + own
        with self.guarded():
            self._link.send([memoryview(GREETING + bytes([COMMAND, len(ready)]) + ready)], deadline)
            begin = self._link.take(10, deadline)
            if begin[0] != 0xFF or not begin[9] & 1:
                raise BadMessage(f"The other side begins with {begin!r}, which is not how ZeroMQ begins.")
            version, mechanism = self._link.take(1, deadline)[0], self._link.take(53, deadline)[1:21].rstrip(b"\0")
            if version < 3 or mechanism != b"NULL":
                raise BadMessage(f"ZeroMQ's version {version} with {mechanism!r}; valid is 3 with b'NULL'.")
            flags, count = self._head(deadline)
            said = self._link.take(count, deadline) if flags & COMMAND else b""
            kind = _properties(said).get(b"socket-type")
            if kind not in theirs:
                raise BadMessage(f"The other side is a socket of the type {kind!r}; valid: {theirs}.")

    def send(self, content: bytes, deadline: Deadline) -> None:
        """Send a message.

        Raises:
            DeadlineExceeded: The other side does not read.
            ConnectionLost: It has gone.
        """
        head = struct.pack(">BBBQ", MORE, 0, LONG, len(content))
        with self.guarded():
            self._link.send([memoryview(head), memoryview(content)], deadline)

    def _receive(self, deadline: Deadline, begun: Deadline | None) -> memoryview:
        rest = self._begun(deadline, begun)
        if self._frame(rest) != (MORE, 0):
            raise BadMessage("A message does not begin with an empty frame.")
        flags, count = self._frame(rest)
        if flags & MORE:
            raise BadMessage("A message has more than one frame behind the empty one.")
        body = np.empty(count, np.uint8)
        self._link.fill(body.data, rest)
        return body.data

    def _frame(self, deadline: Deadline) -> tuple[int, int]:
        """Take the head of the next frame of a message; return whether more follow, and its length."""
        while True:
            flags, count = self._head(deadline)
            if not flags & COMMAND:
                return flags & MORE, count
            said = self._link.take(count, deadline)
            if said.startswith(b"\x04PING"):
                pong = b"\x04PONG" + said[7:]
                self._link.send([memoryview(bytes([COMMAND, len(pong)]) + pong)], deadline)

    def _head(self, deadline: Deadline) -> tuple[int, int]:
        flags = self._link.take(1, deadline)[0]
        count = int.from_bytes(self._link.take(8 if flags & LONG else 1, deadline), "big")
        most = LARGEST_COMMAND if flags & COMMAND else self.largest
        if flags > (MORE | LONG | COMMAND) or count > most:
            raise BadMessage(f"A frame with the flags {flags:#04x} has {count} bytes; valid are up to {most}.")
        return flags, count


def _properties(command: bytes) -> dict[bytes, bytes]:
    """Return what a READY command says, with names in lower case; nothing if it is none."""
    found: dict[bytes, bytes] = {}
    if not command.startswith(b"\x05READY"):
        return found
    at = 6
    while at < len(command):
        value = at + 1 + command[at]
        end = value + 4 + int.from_bytes(command[value : value + 4], "big")
        found[command[at + 1 : value].lower()] = command[value + 4 : end]
        at = end
    return found
