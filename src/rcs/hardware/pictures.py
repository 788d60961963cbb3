"""Pictures of a camera on a network, as an endless JPEG multipart over HTTP.

Most network cameras and camera servers stream like this. A part may say in `X-Timestamp` when its picture was taken
[s], on the camera's own clock; these times are mapped to the host's by a fit.
"""

from __future__ import annotations

import math
import select
import socket
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol
from urllib.parse import SplitResult, urlsplit

import numpy as np
from numpy.typing import NDArray

from rcs.devices import CameraMode
from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware.device_clock import DeviceClock

FIRST_LIMIT = 4.0
"""Longest wait for the first picture of a connection [s]: cameras start slowly."""
READ_LIMIT = 1.0
"""Longest wait for a picture [s]; a camera that gives none for so long is opened again."""
MOST_BYTES = 64 << 20
"""Longest part of a stream that is read; longer ones are not pictures."""
SERIAL = "x-serial-number"
"""Header of a response with the camera's serial number, where it gives one."""


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture as it comes from a camera."""

    content: bytes | memoryview = b""
    """The picture as it was sent, usually a JPEG; empty if `rgb` has it."""
    rgb: NDArray[np.uint8] | None = None
    """The picture, (H, W, 3)."""
    number: int
    """Number of pictures before it in this session, skipped ones included."""
    time: float
    """When it was taken [s, monotonic clock of the host]; without a time of the device, the earliest that it may be."""
    device_time: float = math.nan
    """The same on the device's own clock [s]; NaN without one."""


class Pictures(Protocol):
    """A source of pictures."""

    serial: str
    """Serial number, once it is known."""

    @property
    def clock(self) -> DeviceClock | None:
        """The camera's own clock, if its times are mapped."""
        ...

    def open(self) -> None:
        """Connect."""

    def newest(self) -> Picture:
        """Wait for a picture that was not returned before, skip older ones, and return it.

        Raises:
            DeviceFault: There is none for `READ_LIMIT`, or the connection is lost.
        """
        ...

    def close(self) -> None:
        """Disconnect; closing twice is harmless."""


class HttpPictures:
    """A stream of JPEGs from a URL."""

    def __init__(self, url: str, mode: CameraMode, *, serial: str = "", latency: float = 0.0) -> None:
        """Connect to nothing yet.

        Args:
            url: Its URL, `http://`; size and rate are added as `resolution=640x480&fps=30`.
            mode: Size and rate to ask for.
            serial: Serial number that the camera must have; empty for any, but always the same one.
            latency: Time from a picture to the arrival of the fastest one [s].

        Raises:
            InvalidSetup: The URL is not valid.
        """
        parts = require_url(url)
        self.serial = serial
        self._url, self._host, self._port = url, parts.hostname or "", parts.port or 80
        query = f"resolution={mode.width}x{mode.height}&fps={mode.fps:g}"
        self._path = f"{parts.path or '/'}?{parts.query + '&' if parts.query else ''}{query}"
        self._latency = latency
        self._socket: socket.socket | None = None
        self._rest = bytearray()
        self._received = memoryview(bytearray(1 << 20))
        self._number = -1
        self._empty_at = -math.inf
        self.clock = DeviceClock(latency)
        """The camera's clock; one that goes on while the camera is disconnected keeps its fit."""
        self._is_first = True

    def open(self) -> None:
        """Connect, and ask for the stream.

        Raises:
            InvalidSetup: The camera does not offer the mode, or there is none at that path.
            DeviceFault: No camera answers, it refuses for another reason, or it is another one than before.
        """
        self.close()
        try:
            self._socket = socket.create_connection((self._host, self._port), READ_LIMIT)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket.sendall(f"GET {self._path} HTTP/1.0\r\nHost: {self._host}\r\n\r\n".encode())
        except OSError as err:
            raise DeviceFault(f"no camera answers at {self._url}: {err.strerror or err}") from err
        self._is_first = True
        status, fields = self._head(time.monotonic() + READ_LIMIT)
        if " 200" not in status:
            kind = InvalidSetup if {"400", "404"} & set(status.split()) else DeviceFault
            raise kind(f"{self._url} answers {status!r}: {fields.get('x-reason', 'ask for a mode that it has')}")
        if not fields.get("content-type", "").startswith("multipart/"):
            raise DeviceFault(f"{self._url} gives {fields.get('content-type')!r}, not a stream of JPEGs")
        found = fields.get(SERIAL, "")
        if self.serial and found != self.serial:
            raise DeviceFault(
                f"another camera answers at {self._url}: its serial number is {found!r}, not {self.serial!r}"
            )
        self.serial = found

    def newest(self) -> Picture:
        """Wait for a picture that was not returned before, skip older ones, and return it.

        Raises:
            DeviceFault: There is none for `READ_LIMIT`, or the connection is lost.
        """
        limit = FIRST_LIMIT if self._is_first else READ_LIMIT
        until = time.monotonic() + limit
        found: tuple[dict[str, str], bytes] | None = None
        earliest = self._empty_at if self._is_waiting() else math.nan
        while True:
            if (part := self._part()) is not None:
                found = part
                self._number += 1
            elif found is not None and (time.monotonic() > until or not self._is_waiting()):
                break
            else:
                self._fill(until if found is None else time.monotonic() + READ_LIMIT)
        arrived = self._empty_at = time.monotonic()
        fields, content = found
        is_first, self._is_first = self._is_first, False
        try:
            at = float(fields["x-timestamp"])
        except (KeyError, ValueError):  # it has no clock
            taken = arrived if math.isnan(earliest) else earliest + 1e-6  # after the picture before
            return Picture(content=content, number=self._number, time=max(taken - self._latency, 0.0))
        taken = -math.inf
        try:
            taken = self.clock.host_time(at, arrived)
        except DeviceFault:
            if not is_first:
                self.clock = DeviceClock(self._latency)  # of the times from here on, the fit knows nothing
                raise
        # A first picture that is so late says that the camera's clock has begun anew with the connection.
        if is_first and arrived - taken > READ_LIMIT + self._latency:
            self.clock = DeviceClock(self._latency)
            taken = self.clock.host_time(at, arrived)
        return Picture(content=content, number=self._number, time=taken, device_time=at)

    def close(self) -> None:
        """Disconnect; closing twice is harmless."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        self._rest.clear()
        self._empty_at = time.monotonic()

    def interrupt(self) -> None:
        """End the connection of another thread, which reads from it."""
        if (connected := self._socket) is not None:
            with suppress(OSError):  # it has ended
                connected.shutdown(socket.SHUT_RDWR)

    def _is_waiting(self) -> bool:
        """Return whether bytes wait to be read."""
        return self._socket is not None and bool(select.select([self._socket], [], [], 0)[0])

    def _part(self) -> tuple[dict[str, str], bytes] | None:
        """Return the fields and content of the next part, if all of it has come."""
        end = self._rest.find(b"\r\n\r\n")
        if end < 0:
            return None
        fields = _fields(bytes(self._rest[:end]))
        try:
            length = int(fields["content-length"])
        except (KeyError, ValueError) as err:
            raise DeviceFault(f"a part of {self._url} has no length") from err
        if not 0 <= length <= MOST_BYTES:
            raise DeviceFault(f"a part of {self._url} has {length} bytes, too many for a picture")
        if len(self._rest) < end + 4 + length:
            return None
        with memoryview(self._rest) as received:
            content = bytes(received[end + 4 : end + 4 + length])
        del self._rest[: end + 4 + length]
        return fields, content

    def _head(self, until: float) -> tuple[str, dict[str, str]]:
        while (end := self._rest.find(b"\r\n\r\n")) < 0:
            self._fill(until)
        head = bytes(self._rest[:end])
        del self._rest[: end + 4]
        return head.split(b"\r\n")[0].decode("latin-1"), _fields(head)

    def _fill(self, until: float) -> None:
        """Read what has come, or wait for it."""
        if self._socket is None:
            raise DeviceFault(f"the camera at {self._url} is not connected")
        if (left := until - time.monotonic()) <= 0:
            raise DeviceFault(f"no picture from {self._url} in time")
        self._socket.settimeout(left)
        try:
            count = self._socket.recv_into(self._received)
        except TimeoutError as err:
            raise DeviceFault(f"no picture from {self._url} in time") from err
        except OSError as err:
            raise DeviceFault(f"the connection to {self._url} is lost: {err.strerror or err}") from err
        if not count:
            raise DeviceFault(f"{self._url} has ended the stream")
        if len(self._rest) > MOST_BYTES:
            raise DeviceFault(f"{self._url} gives no pictures")
        self._rest += self._received[:count]


def require_url(url: str) -> SplitResult:
    """Return the parts of a camera's URL.

    Raises:
        InvalidSetup: It is not valid.
    """
    try:
        parts = urlsplit(url)
        is_valid = parts.scheme == "http" and bool(parts.hostname) and parts.port != 0
    except ValueError:  # the port, or a bracket that is not closed
        is_valid = False
        parts = urlsplit("")
    if not is_valid:
        raise InvalidSetup(f"The address of a camera is {url!r}; valid on a network is 'http://HOST:PORT/PATH'.")
    return parts


def _fields(head: bytes) -> dict[str, str]:
    pairs = (line.partition(":") for line in head.decode("latin-1").split("\r\n"))
    return {name.strip().lower(): value.strip() for name, colon, value in pairs if colon}
