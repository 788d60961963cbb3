"""Where servers of any wire listen, who may reach them, and a thread for each connection."""

from __future__ import annotations

import contextlib
import errno
import logging
import socket
import ssl
import threading
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
MOST_CALLERS = 64
"""Connections at a time."""


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
            return socket.create_server((self.host, self.port), family=family, backlog=16)

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


class Acceptor:
    """Takes connections at sockets that listen; a thread of its own answers each."""

    def __init__(self) -> None:
        """Begin with no socket."""
        self._listeners: list[socket.socket] = []
        self._threads: list[threading.Thread] = []
        self._open: set[Stoppable] = set()
        self._lock = threading.Lock()
        self.is_closing = threading.Event()
        """Whether `close` was called."""

    @property
    def open(self) -> list[Any]:
        """The conversations that go on."""
        with self._lock:
            return list(self._open)

    def listen(self, listener: socket.socket, converse: Callable[[socket.socket, str], None]) -> None:
        """Take connections at a socket.

        Args:
            listener: It is closed with this.
            converse: Takes a connection and the name of whoever is there; the connection is closed when it returns.
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
        """Take no more connections, and end those that are. A second call does nothing."""
        self.is_closing.set()
        for listener in self._listeners:
            with contextlib.suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)  # wakes the thread that waits there
            listener.close()
        for conversation in self.open:
            conversation.stop()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(TRANSFER + BEGIN)

    def _accept(self, listener: socket.socket, converse: Callable[[socket.socket, str], None]) -> None:
        while not self.is_closing.is_set():
            try:
                connection, peer = listener.accept()
            except OSError:
                if self.is_closing.wait(0.05):  # out of files: others may end soon
                    return
                continue
            name = f"{peer[0]}:{peer[1]}" if isinstance(peer, tuple) else "this machine"
            with self._lock:
                count = sum(thread.name.startswith("vlagents with") for thread in self._threads if thread.is_alive())
            if count >= MOST_CALLERS:
                _log.warning("A connection was refused: there are %d already", MOST_CALLERS)
                connection.close()
                continue
            self.run(f"vlagents with {name}", self._answer, connection, name, converse)

    def _answer(self, connection: socket.socket, name: str, converse: Callable[[socket.socket, str], None]) -> None:
        try:
            converse(connection, name)
        finally:
            connection.close()
