"""The server of the page for headsets: page and stream from one port, over TLS.

Threads: one accepts, one per connection serves; the newest frames wait in a queue for the thread that reads the device.
"""

from __future__ import annotations

import contextlib
import fcntl
import hmac
import json
import logging
import queue
import socket
import ssl
import sys
import termios
import threading
import time
from collections import Counter
from importlib import resources
from typing import Any

from rcs.errors import InvalidSetup
from rcs.extras import package_of
from rcs.teleop.headset_messages import FrameMessage, decode

_log = logging.getLogger(__name__)

LARGEST = 4096
"""Largest message [bytes]."""
GREETING = 5.0
"""Time in which a page says its code [s]."""
WAITING = 1.0
"""Pause after a wrong code, for all who try [s]."""
SILENT = 2.0
"""Time after which a silent headset gives its place to another [s]."""
WAITING_FRAMES = 32
"""Most frames that wait to be read; older ones are dropped."""
BUFFER = 1 << 20
"""Room for what the network has not taken yet, such as a picture [bytes]: until there is, nothing is read either."""
KEPT_BACK = 1 << 16
"""Bytes that the network has not taken yet from which on it is too slow for another picture."""
PEERS = 16
"""Most connections at a time."""
TLS = b"\x16"
"""First byte of a client that speaks TLS."""
FILES = {"/": ("headset.html", "text/html"), "/headset.js": ("headset.js", "text/javascript")}
POLICY = "default-src 'none'; script-src 'self'; style-src 'unsafe-inline'; connect-src 'self'; img-src blob:"
"""Content security policy of the page: it may load nothing from elsewhere."""
WRONG_CODE = "This is not the code that the program shows."
PLAIN = b"This port speaks TLS. Open the same address with https:// in front.\n"


class _Socket(ssl.SSLSocket):
    """A connection that answers plain HTTP in words."""

    def do_handshake(self, block: bool = False) -> None:
        if socket.socket.recv(self, 1, socket.MSG_PEEK) not in (TLS, b""):
            answer = b"HTTP/1.1 400 Bad Request\r\nContent-Type: text/plain\r\nConnection: close\r\nContent-Length: "
            socket.socket.recv(self, LARGEST)  # what is unread would reset the connection
            socket.socket.sendall(self, answer + str(len(PLAIN)).encode() + b"\r\n\r\n" + PLAIN)
            raise ssl.SSLError("plain HTTP")
        super().do_handshake(block)


class HeadsetServer:
    """Serves one headset at a time."""

    def __init__(self, host: str, port: int, code: str, tls: ssl.SSLContext) -> None:
        """Listen.

        Args:
            host: Address of this machine; 0.0.0.0 for all.
            port: Port; 0 for any.
            code: Code that a page has to send before it is heard.
            tls: Settings with the certificate.

        Raises:
            InvalidSetup: The address is not this machine's, or the port is taken.
            MissingDependency: The package for websockets is not installed.
        """
        self._serve: Any = package_of("teleop", "websockets.sync.server", "A page for headsets needs")
        self._http: Any = package_of("teleop", "websockets.http11")
        self._headers: Any = package_of("teleop", "websockets.datastructures").Headers
        self._closed: Any = package_of("teleop", "websockets.exceptions").ConnectionClosed
        self.counts = Counter[str]()
        """Counts of what could not be used, by kind."""
        self.frames = queue.Queue[tuple[float, FrameMessage]](WAITING_FRAMES)
        """Frames with the time of their arrival [s, `time.monotonic()`], oldest first."""
        self.sessions = 0
        """Number of headsets that were accepted."""
        self._code, self._is_closing = code, threading.Event()
        self._place, self._trying = threading.Lock(), threading.Lock()
        self._headset: Any = None
        self._heard = 0.0
        self._peers = threading.Semaphore(PEERS)
        tls.sslsocket_class = _Socket
        quiet = logging.getLogger(f"{__name__}.connections")
        quiet.setLevel(logging.CRITICAL)  # anybody may send rubbish to a port
        try:
            self._server: Any = self._serve.serve(
                self._handle, host, port, ssl=tls, process_request=self._answer, max_size=LARGEST, logger=quiet,
                compression=None, ping_interval=None, close_timeout=0.5, open_timeout=GREETING,
            )  # fmt: skip
        except OSError as err:
            raise InvalidSetup(
                f"Headsets cannot be awaited at {host}:{port}: {err.strerror}. Give an address of this machine and a "
                "free port, such as quest:0.0.0.0:8444."
            ) from err
        self.port: int = self._server.socket.getsockname()[1]
        """Port at which it listens."""
        threading.Thread(target=self._accept, name="rcs headset server", daemon=True).start()

    def send(self, message: str | bytes) -> None:
        """Send a message to the headset, if there is one; may wait for a slow network."""
        headset = self._headset
        if headset is not None:
            try:
                headset.send(message)
            except (self._closed, OSError):
                return  # it is gone; what it last said becomes stale

    @property
    def is_keeping_up(self) -> bool:
        """Whether the network takes what is sent; while a message waits for it, what the headset says is not read."""
        headset = self._headset
        if headset is None:
            return False
        try:
            waiting = fcntl.ioctl(headset.socket, termios.TIOCOUTQ, bytes(4))
        except (OSError, ValueError):  # it is gone
            return False
        return int.from_bytes(waiting, sys.byteorder) < KEPT_BACK

    def close(self) -> None:
        """End all connections."""
        self._is_closing.set()
        with contextlib.suppress(OSError):
            self._server.socket.shutdown(socket.SHUT_RDWR)  # wakes the thread that accepts
        self._server.shutdown()
        headset = self._headset
        if headset is not None:
            headset.close()

    def _accept(self) -> None:
        while not self._is_closing.is_set():
            try:
                connection, peer = self._server.socket.accept()
            except OSError:
                self._is_closing.wait(0.01)
                continue
            if not self._peers.acquire(blocking=False):
                connection.close()
                continue
            thread = threading.Thread(target=self._attend, args=(connection, peer), name="rcs headset", daemon=True)
            thread.start()

    def _attend(self, connection: Any, peer: Any) -> None:
        try:
            self._server.handler(connection, peer)
        finally:
            self._peers.release()

    def _answer(self, connection: Any, request: Any) -> Any:
        """Return a file of the page, or None where the stream begins."""
        path = request.path.partition("?")[0]
        if path == "/stream":
            return None
        file, kind = FILES.get(path, ("", "text/plain"))
        body = resources.files("rcs.teleop").joinpath(file).read_bytes() if file else b"There is nothing here.\n"
        headers = self._headers({
            "Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(body)), "Connection": "close",
            "Cache-Control": "no-store", "Content-Security-Policy": POLICY, "X-Content-Type-Options": "nosniff",
        })  # fmt: skip
        return self._http.Response(200 if file else 404, "OK" if file else "Not Found", headers, body)

    def _handle(self, connection: Any) -> None:
        """Serve a page from its greeting on."""
        try:
            if refusal := self._greet(connection):
                connection.send(json.dumps({"refused": refusal, "is_wrong_code": refusal == WRONG_CODE}))
                return
            try:
                connection.send(json.dumps({"accepted": True}))
                self._listen(connection)
            finally:
                with self._place:
                    if self._headset is connection:
                        self._headset = None
        except (self._closed, TimeoutError, OSError):
            return

    def _greet(self, connection: Any) -> str:
        """Give a page its place, or return why not."""
        said = connection.recv(timeout=GREETING)
        given = said.encode() if isinstance(said, str) else said
        if not hmac.compare_digest(given, self._code.encode()):
            with self._trying:
                self.counts["wrong code"] += 1
                self._is_closing.wait(WAITING)
            return WRONG_CODE
        with self._place:
            if self._headset is not None and time.monotonic() < self._heard + SILENT:
                return "Another headset leads; close its page first."
            connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
            former, self._headset = self._headset, connection
            self._heard = time.monotonic()
            self.sessions += 1
        if former is not None:
            former.close()
        _log.info("a headset is connected: %s", connection.remote_address[0])
        return ""

    def _listen(self, connection: Any) -> None:
        number, sent = -1, -1.0
        while self._headset is connection and not self._is_closing.is_set():
            data = connection.recv()
            arrived = time.monotonic()
            frame = decode(data)
            if frame is None:
                self.counts["damaged"] += 1
                continue
            if frame.number <= number or frame.time <= sent:
                self.counts["disordered"] += 1
                continue
            number, sent, self._heard = frame.number, frame.time, arrived
            if self.frames.full():
                with contextlib.suppress(queue.Empty):  # the reader has just taken it
                    self.frames.get_nowait()
                    self.counts["dropped"] += 1
            with contextlib.suppress(queue.Full):  # a headset that has just lost its place still speaks
                self.frames.put_nowait((arrived, frame))
            connection.send(json.dumps({"echo": frame.number}))
