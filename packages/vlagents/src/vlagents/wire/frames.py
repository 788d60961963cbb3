"""Messages of a websocket (RFC 6455) after its handshake, over a socket with deadlines.

Pictures are megabytes: they are masked piece by piece on the way out, and unmasked piece by piece as they come. Sizes
are compared with what is allowed before anything is allocated.
"""

from __future__ import annotations

import contextlib
import os
import struct
import sys
import threading
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vlagents.errors import BadMessage, ConnectionLost, VlagentsError
from vlagents.wire.link import LARGEST_BODY, Channel, Deadline, Link
from vlagents.wire.stream import KEPT

GO_ON, TEXT, BINARY, CLOSE, PING, PONG = 0, 1, 2, 8, 9, 10
LAST, MASKED = 0x80, 0x80
MOST_OF_CONTROL = 125
"""Most bytes of a close, ping or pong."""
LARGEST_TEXT = 1 << 20
"""Most bytes of a message of text: openpi's servers say in one what went wrong."""
PIECE = 256 << 10
"""Bytes that are masked at a time, so that they are still at hand when they are sent [bytes]."""
NORMAL, PROTOCOL, NOT_UTF8, TOO_LARGE = 1000, 1002, 1007, 1009
"""Reasons to close."""
Part = bytes | memoryview


class FrameChannel(Channel):
    """Sends and receives messages. One thread at a time may receive, and any may send."""

    def __init__(self, link: Link, *, is_client: bool, largest: int = LARGEST_BODY) -> None:
        """Take over a link whose handshake is done.

        Args:
            link: It is closed with the channel.
            is_client: Whether this is the client's side, which masks its messages.
            largest: Most bytes of a received message.
        """
        super().__init__(link, largest=largest)
        self._is_client = is_client
        self._reading, self._writing = threading.Lock(), threading.Lock()
        self._body = np.empty(0, np.uint8)
        self._scratch = np.empty(PIECE if is_client else 0, np.uint8)

    def send(self, message: str | Sequence[Part], deadline: Deadline) -> None:
        """Send a message of text, or of the bytes of all parts together.

        Raises:
            DeadlineExceeded: The other side does not read; the connection is closed.
            ConnectionLost: It has gone.
        """
        parts = [message.encode()] if isinstance(message, str) else message
        with self.guarded(), self._writing:
            self._write(TEXT if isinstance(message, str) else BINARY, parts, deadline)

    def attend(self) -> None:
        """Answer pings while no thread receives; do nothing while one does."""
        if not self._reading.acquire(blocking=False):
            return
        try:
            if self._writing.acquire(blocking=False):  # TLS takes one thread at a time, to read or to write
                try:
                    while self._pass_control(self._link.peek()):
                        pass
                finally:
                    self._writing.release()
        except (VlagentsError, OSError):
            pass  # the next call of `receive` raises it
        finally:
            self._reading.release()

    def close(self, code: int = NORMAL, reason: str = "", *, linger: float = 0.0) -> None:
        """Say that the conversation is over, and close.

        Args:
            code: Why, as the RFC numbers it.
            reason: The same in words.
            linger: How long to wait for the other side to read to the end [s]; without, what it has not read is lost.
        """
        soon = Deadline(max(linger, 0.1), "reading of the end")
        with contextlib.suppress(VlagentsError, OSError):
            self._say_over(code, reason, soon)
            while linger > 0.0:
                self._link.skip(len(self._link.need(1, soon)))
        self._link.close()

    def stop(self) -> None:
        """End the connection from another thread; the one that reads learns that it has gone, and closes it."""
        with contextlib.suppress(VlagentsError, OSError):
            self._say_over(NORMAL, "", Deadline(0.1, "reading of the end"))
        self._link.stop()

    def _say_over(self, code: int, reason: str, soon: Deadline) -> None:
        if self._writing.acquire(timeout=0.1):
            try:
                self._write(CLOSE, [struct.pack(">H", code) + reason.encode()[: MOST_OF_CONTROL - 2]], soon)
            finally:
                self._writing.release()

    def _write(self, kind: int, parts: Sequence[Part], deadline: Deadline) -> None:
        size = sum(len(part) for part in parts)
        mask = MASKED if self._is_client else 0
        if size < 126:
            head = struct.pack(">BB", LAST | kind, mask | size)
        elif size < 1 << 16:
            head = struct.pack(">BBH", LAST | kind, mask | 126, size)
        else:
            head = struct.pack(">BBQ", LAST | kind, mask | 127, size)
        if not self._is_client:
            self._link.send([memoryview(head), *(memoryview(part) for part in parts)], deadline)
            return
        key = os.urandom(4)
        waiting, at, used = [memoryview(head + key)], 0, 0
        for part in parts:
            source = np.frombuffer(part, np.uint8)
            while len(source):
                if used >= len(self._scratch):
                    self._link.send(waiting, deadline)
                    waiting, used = [], 0
                count = min(len(source), len(self._scratch) - used)
                masked = self._scratch[used : used + count]
                mask_into(masked, source[:count], key, at)
                waiting.append(masked.data)
                source, at = source[count:], at + count
                used += -(-count // 8) * 8
        self._link.send(waiting, deadline)

    def _receive(self, deadline: Deadline, begun: Deadline | None) -> str | memoryview:
        with self._reading:
            return self._next(deadline, begun)

    def _next(self, deadline: Deadline, begun: Deadline | None) -> str | memoryview:
        kind, size = GO_ON, 0
        rest = deadline
        if sys.getrefcount(self._body) > 2:  # an array of the last message is still in use
            self._body = np.empty(0, np.uint8)
        while True:
            if rest is deadline:
                rest = self._begun(deadline, begun)
            first, count, key = self._head(rest)
            opcode = first & 0x0F
            if opcode >= CLOSE:
                self._control(opcode, _unmasked(self._link.take(count, rest), key), rest)
                if kind == GO_ON:
                    rest = deadline
                continue
            if (opcode == GO_ON) != (kind != GO_ON):
                raise self._refused(PROTOCOL, "A message begins inside another, or goes on where none began")
            kind = opcode or kind
            most = min(self.largest, LARGEST_TEXT) if kind == TEXT else self.largest
            if size + count > most:
                raise self._refused(TOO_LARGE, f"A message of {size + count} bytes is too large; valid: {most}")
            self._read(size, count, key, rest)
            size += count
            if first & LAST:
                return self._message(kind, size)

    def _head(self, deadline: Deadline) -> tuple[int, int, bytes]:
        """Take the head of a frame; return its first byte, its length, and its key if it is masked."""
        first, second = self._link.take(2, deadline)
        count = second & 0x7F
        if first & 0x70 or first & 0x0F not in (GO_ON, TEXT, BINARY, CLOSE, PING, PONG):
            raise self._refused(PROTOCOL, f"A frame begins with {first:#04x}, which is not in use")
        if bool(second & MASKED) == self._is_client:
            raise self._refused(PROTOCOL, "A frame is masked, or not, against the rule")
        if first & 0x08 and (count > MOST_OF_CONTROL or not first & LAST):
            raise self._refused(PROTOCOL, "A control frame is too long or in pieces")
        if count == 126:
            (count,) = struct.unpack(">H", self._link.take(2, deadline))
        elif count == 127:
            (count,) = struct.unpack(">Q", self._link.take(8, deadline))
        return first, count, b"" if self._is_client else self._link.take(4, deadline)

    def _read(self, start: int, count: int, key: bytes, deadline: Deadline) -> None:
        """Read the bytes of a frame behind those that the message has already."""
        if start + count > len(self._body):
            body = np.empty(max(start + count, 2 * start), np.uint8)
            body[:start] = self._body[:start]
            self._body = body
        for at in range(0, count, PIECE):
            piece = self._body[start + at : start + min(at + PIECE, count)]
            self._link.fill(piece.data, deadline)
            if key:
                mask_into(piece, piece, key, at)

    def _message(self, kind: int, size: int) -> str | memoryview:
        body = self._body[:size]
        if len(self._body) > KEPT:
            self._body = np.empty(0, np.uint8)
        if kind == BINARY:
            return body.data
        try:
            return bytes(body).decode()
        except UnicodeDecodeError as error:
            raise self._refused(NOT_UTF8, "A message of text is not UTF-8") from error

    def _control(self, opcode: int, data: bytes, deadline: Deadline) -> None:
        if opcode == PING:
            with self._writing:
                self._write(PONG, [data], deadline)
        elif opcode == CLOSE:
            code = struct.unpack(">H", data[:2])[0] if len(data) >= 2 else NORMAL
            with contextlib.suppress(VlagentsError, OSError), self._writing:
                self._write(CLOSE, [data[:2]], Deadline(0.1, "reading of the end"))
            why = data[2:].decode(errors="replace")
            raise ConnectionLost(f"The other side has closed the connection ({code}{why and ': ' + why}).")

    def _pass_control(self, ahead: memoryview) -> bool:
        """Answer and skip a ping or pong that is there as a whole; return whether there was one."""
        long = 2 if self._is_client else 6
        if len(ahead) < 2 or ahead[0] & 0x0F not in (PING, PONG) or len(ahead) < long + (ahead[1] & 0x7F):
            return False
        count = ahead[1] & 0x7F
        if count > MOST_OF_CONTROL or bool(ahead[1] & MASKED) == self._is_client:
            return False
        data = bytes(ahead[long : long + count])
        if ahead[0] & 0x0F == PING:
            self._write(PONG, [_unmasked(data, bytes(ahead[2:long]))], Deadline(0.1, "reading of a pong"))
        self._link.skip(long + count)
        return True

    def _refused(self, code: int, why: str) -> BadMessage:
        self.close(code, why)
        return BadMessage(f"{why}.")


def mask_into(out: NDArray[np.uint8], source: NDArray[np.uint8], key: bytes, at: int) -> None:
    """Mask bytes, or unmask them, which is the same; `out` may be `source`.

    Args:
        out: Where they go, as many.
        source: The bytes.
        key: Four bytes, which are repeated.
        at: Where in the frame the bytes begin.
    """
    turned = (key[at % 4 :] + key[: at % 4]) * 2
    whole = len(source) & ~7
    word = np.frombuffer(turned, np.uint64)[0]
    np.bitwise_xor(source[:whole].view(np.uint64), word, out=out[:whole].view(np.uint64))
    end = np.frombuffer(turned, np.uint8)[: len(source) - whole]
    np.bitwise_xor(source[whole:], end, out=out[whole:])


def _unmasked(data: bytes, key: bytes) -> bytes:
    return bytes(byte ^ key[i % 4] for i, byte in enumerate(data)) if key else data
