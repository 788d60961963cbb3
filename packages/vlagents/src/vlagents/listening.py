"""Where servers of any wire listen, who may reach them, and a thread for each connection."""

from __future__ import annotations

import contextlib
import errno
import logging
import socket
import ssl
import threading
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from vlagents.address import is_loopback
from vlagents.errors import AddressTaken, InvalidInput

_log = logging.getLogger(__name__)

BEGIN = 5.0
"""How long a new connection may take to say who it is [s]."""
TRANSFER = 10.0
"""How long a message may take to come once it began, and an answer to be read [s]."""
LEAVING = 1.0
"""How long the end of a server waits for what goes on there [s]."""
MOST_CALLERS = 64
"""Connections at a time."""
STRANGER = 64 << 10
"""Most bytes of arrays that somebody may send who is not known yet."""


@dataclass(frozen=True, kw_only=True)
class Listening:
    """Where a server listens, and how whoever reaches it is kept honest."""

    host: str = "127.0.0.1"
    """Anything but this machine itself needs a token."""
    port: int = 0
    """Of TCP; 0 for any that is free."""
    token: str | None = None
    """What clients must know; None for nothing."""
    certificate: str | Path | None = None
    """File with a certificate, for TLS."""
    key: str | Path | None = None
    """File with its key."""

    def __post_init__(self) -> None:
        """Check the fields.

        Raises:
            InvalidInput: The address is open to others and there is no token, or TLS is half given.
        """
        if not is_loopback(self.host) and self.token is None:
            raise InvalidInput(
                f"The host {self.host!r} can be reached from other machines, and there is no token: anybody could ask "
                "the policy. Give a token, or listen at 127.0.0.1."
            )
        if self.token is not None and not self.token:
            raise InvalidInput("The token is empty; valid is a str that cannot be guessed, or None.")
        if (self.certificate is None) != (self.key is None):
            raise InvalidInput("TLS needs both, certificate and key.")

    def tls(self) -> ssl.SSLContext | None:
        """Return what encrypts, None for nothing.

        Raises:
            OSError: A file is missing, or is none.
        """
        if self.certificate is None:
            return None
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(self.certificate, self.key)
        return context

    def open(self) -> socket.socket:
        """Return a socket that listens.

        Raises:
            AddressTaken: Something listens there already.
            OSError: The port cannot be had.
        """
        family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
        with self.taken_is_told():
            return socket.create_server((self.host, self.port), family=family, backlog=2 * MOST_CALLERS)

    @contextlib.contextmanager
    def taken_is_told(self) -> Generator[None]:
        """Have an address that is taken be an error of ours.

        Raises:
            AddressTaken: It is.
        """
        try:
            yield
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            raise AddressTaken(self.host, self.port) from error


class Stoppable(Protocol):
    """A conversation that another thread can end."""

    def stop(self) -> None:
        """Have whoever reads or writes there learn that it is over."""
        ...


@dataclass(eq=False)
class Guest:
    """Whoever has connected."""

    name: str
    """Where it comes from, for the log."""
    connection: socket.socket
    is_known: bool = False
    """Whether it has said who it is. When there are too many, the oldest that has not gives way to a new one."""

    def secure(self, context: ssl.SSLContext) -> None:
        """Have TLS on the connection.

        Raises:
            OSError: The other side has none, or takes too long.
        """
        self.connection.settimeout(BEGIN)
        # The handshake comes after the connection is replaced, so that `stop` ends it, too.
        encrypted = context.wrap_socket(self.connection, server_side=True, do_handshake_on_connect=False)
        self.connection = encrypted
        encrypted.do_handshake()

    def stop(self) -> None:
        """Have whoever reads or writes there learn that it is over."""
        with contextlib.suppress(OSError):
            socket.socket.shutdown(self.connection, socket.SHUT_RDWR)  # of TLS too, whose own forgets the encryption


class Acceptor:
    """Takes connections at sockets that listen; a thread of its own answers each."""

    def __init__(self) -> None:
        """Begin with no socket."""
        self._listeners: list[socket.socket] = []
        self._threads: list[threading.Thread] = []
        self._guests: dict[Guest, None] = {}
        self._open: set[Stoppable] = set()
        self._lock = threading.Lock()
        self.is_closing = threading.Event()
        """Whether `close` was called."""

    @property
    def open(self) -> list[Any]:
        """The conversations that go on."""
        with self._lock:
            return list(self._open)

    def listen(self, listener: socket.socket, converse: Callable[[Guest], None]) -> None:
        """Take connections at a socket.

        Args:
            listener: It is closed with this.
            converse: Talks with a guest, and says when it is known; the connection is closed when it returns.
        """
        self._listeners.append(listener)
        self.run(f"vlagents accept {listener.getsockname()}", self._accept, listener, converse)

    def run(self, name: str, act: Callable[..., None], *given: Any) -> None:
        """Do something in a thread of its own, which `close` waits for."""
        thread = threading.Thread(target=act, args=given, name=name, daemon=True)
        with self._lock:
            self._threads = [other for other in self._threads if other.is_alive()]
            self._threads.append(thread)
        thread.start()

    def enter(self, conversation: Stoppable) -> None:
        """Have `close` end a conversation."""
        with self._lock:
            self._open.add(conversation)
        if self.is_closing.is_set():
            conversation.stop()

    def leave(self, conversation: Stoppable) -> None:
        """Say that a conversation is over."""
        with self._lock:
            self._open.discard(conversation)

    def close(self) -> None:
        """Take no more connections, and end those that are. A second call does nothing.

        What has not ended after `LEAVING` seconds, because the policy still works on it, is left to itself.
        """
        self.is_closing.set()
        for listener in self._listeners:
            with contextlib.suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)  # wakes the thread that waits there
            listener.close()
        with self._lock:
            stoppable = [*self._open, *self._guests]
        for each in stoppable:
            each.stop()
        end = time.monotonic() + LEAVING
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(max(end - time.monotonic(), 0.0))

    def _accept(self, listener: socket.socket, converse: Callable[[Guest], None]) -> None:
        while not self.is_closing.is_set():
            try:
                connection, peer = listener.accept()
            except OSError:
                if self.is_closing.wait(0.05):  # out of files: others may end soon
                    return
                continue
            guest = Guest(f"{peer[0]}:{peer[1]}" if isinstance(peer, tuple) else "this machine", connection)
            if not self._seat(guest):
                _log.warning("%s was refused: there are %d connections already", guest.name, MOST_CALLERS)
                connection.close()
                continue
            self.run(f"vlagents with {guest.name}", self._answer, guest, converse)

    def _seat(self, guest: Guest) -> bool:
        """Return whether there is room for a guest, if need be because one that has said nothing must go."""
        with self._lock:
            if len(self._guests) >= MOST_CALLERS:
                silent = next((other for other in self._guests if not other.is_known), None)
                if silent is None:
                    return False
                _log.warning("%s has not said who it is, and gave way to %s", silent.name, guest.name)
                del self._guests[silent]
                silent.stop()
            self._guests[guest] = None
            return True

    def _answer(self, guest: Guest, converse: Callable[[Guest], None]) -> None:
        try:
            converse(guest)
        finally:
            with self._lock:
                self._guests.pop(guest, None)
            guest.connection.close()
