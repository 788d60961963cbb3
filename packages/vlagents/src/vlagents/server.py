"""Serves a policy over TCP, and over shared memory to whoever is on the same machine."""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import ssl
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

from vlagents.address import Address, is_loopback, is_own_socket, socket_beside
from vlagents.errors import BadMessage, ConnectionLost, InvalidInput, Unauthorized, VlagentsError
from vlagents.policy import Policy
from vlagents.service import Caller, Service
from vlagents.wire.calls import failure
from vlagents.wire.deadline import Deadline
from vlagents.wire.shared import SharedChannel, is_supported, peer_user
from vlagents.wire.stream import LARGEST_BODY, StreamChannel

_log = logging.getLogger(__name__)

BEGIN = 5.0
"""How long a new connection may take to say hello [s]."""
TRANSFER = 10.0
"""How long a message may take to come once it began, and an answer to be read [s]."""
STRANGER = 64 << 10
"""Most bytes of arrays that somebody may send who has not said hello."""
MOST_CALLERS = 64
"""Connections at a time."""


class Server:
    """Answers calls over TCP at one address, and over a Unix socket with shared memory beside it.

    Example:
        >>> from vlagents import Observation
        >>> from vlagents.client import Client
        >>> from vlagents.policies.random import RandomPolicy
        >>> from vlagents.server import Server
        >>> with Server(RandomPolicy(size=7), port=0) as server, Client(str(server.address)) as client:
        ...     client.infer(Observation()).actions.shape
        (1, 7)
    """

    def __init__(
        self,
        policy: Policy,
        *,
        host: str = "127.0.0.1",
        port: int = 8090,
        token: str | None = None,
        certificate: str | Path | None = None,
        key: str | Path | None = None,
        largest_body: int = LARGEST_BODY,
        transfer: float = TRANSFER,
    ) -> None:
        """Prepare; `start` or a `with` block opens the sockets.

        Args:
            policy: It is closed with the server.
            host: Where to listen. Anything but this machine itself needs a token.
            port: Of TCP; 0 for any that is free.
            token: What clients must know; None for nothing.
            certificate: File with a certificate, for TLS.
            key: File with its key.
            largest_body: Most bytes of arrays in a message.
            transfer: How long a message may take to come once it began, and an answer to be read [s].

        Raises:
            InvalidInput: The address is open to others and there is no token, or TLS is half given.
        """
        if not is_loopback(host) and token is None:
            raise InvalidInput(
                f"The host {host!r} can be reached from other machines, and there is no token: anybody could ask the "
                "policy. Give a token, or listen at 127.0.0.1."
            )
        if (certificate is None) != (key is None):
            raise InvalidInput("TLS needs both, certificate and key.")
        self.service = Service(policy, token=token)
        self._host, self._port = host, port
        self._largest_body, self._transfer = largest_body, transfer
        self._tls: ssl.SSLContext | None = None
        if certificate is not None:
            self._tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            self._tls.load_cert_chain(certificate, key)
        self._listeners: list[socket.socket] = []
        self._threads: list[threading.Thread] = []
        self._open: set[StreamChannel] = set()
        self._lock = threading.Lock()
        self._is_closing = threading.Event()
        self._unix: Path | None = None

    @property
    def address(self) -> Address:
        """Where the server listens."""
        return Address("vla" if self._tls is None else "vlas", host=self._host, port=self._port)

    def start(self) -> Server:
        """Listen, and answer in threads of its own.

        Raises:
            OSError: The port is taken.
        """
        listener = socket.create_server((self._host, self._port), family=_family(self._host), backlog=16)
        self._port = listener.getsockname()[1]
        self._listen(listener, self._over_tcp)
        if is_supported() and is_loopback(self._host) and self._tls is None:
            self._listen_beside()
        return self

    def serve_forever(self) -> None:
        """Wait until `close` is called, from another thread or a signal's handler."""
        self._is_closing.wait()

    def close(self) -> None:
        """End all connections, then the policy. A second call does nothing."""
        self._is_closing.set()
        for listener in self._listeners:
            with contextlib.suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)
            listener.close()
        self._listeners.clear()
        if self._unix is not None:
            self._unix.unlink(missing_ok=True)
            self._unix = None
        with self._lock:
            for channel in self._open:
                channel.close()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(timeout=self._transfer + BEGIN)
        self.service.close()

    def __enter__(self) -> Server:
        """Start."""
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()

    def _listen_beside(self) -> None:
        """Listen at the Unix socket that belongs to the port; without one, clients use TCP."""
        try:
            path = socket_beside(self._port)
            if is_own_socket(path):  # of a server that was killed: the port is ours, so nobody uses it
                path.unlink()
            listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            listener.bind(str(path))
            os.chmod(path, 0o600)
            listener.listen(16)
        except (OSError, InvalidInput) as error:
            _log.warning("There is no shared memory for clients on this machine: %s", error)
            return
        self._unix = path
        self._listen(listener, self._over_memory)

    def _listen(self, listener: socket.socket, welcome: Callable[[socket.socket], StreamChannel]) -> None:
        self._listeners.append(listener)
        self._run(f"vlagents accept {listener.getsockname()}", self._accept, listener, welcome)

    def _run(self, name: str, act: Callable[..., None], *given: Any) -> None:
        thread = threading.Thread(target=act, args=given, name=name, daemon=True)
        with self._lock:
            self._threads = [other for other in self._threads if other.is_alive()]
            self._threads.append(thread)
        thread.start()

    def _accept(self, listener: socket.socket, welcome: Callable[[socket.socket], StreamChannel]) -> None:
        while not self._is_closing.is_set():
            try:
                connection, peer = listener.accept()
            except OSError:
                if self._is_closing.wait(0.05):  # out of files: others may end soon
                    return
                continue
            if len(self._open) >= MOST_CALLERS:
                _log.warning("A connection was refused: there are %d already", MOST_CALLERS)
                connection.close()
                continue
            name = f"{peer[0]}:{peer[1]}" if isinstance(peer, tuple) else "this machine"
            self._run(f"vlagents {name}", self._converse, connection, welcome, self.service.caller(name))

    def _over_tcp(self, connection: socket.socket) -> StreamChannel:
        if self._tls is not None:
            connection.settimeout(BEGIN)
            connection = self._tls.wrap_socket(connection, server_side=True)
        return StreamChannel(connection, largest_body=STRANGER)

    def _over_memory(self, connection: socket.socket) -> StreamChannel:
        if peer_user(connection) != os.getuid():
            raise Unauthorized("Somebody else is at the socket.")
        return SharedChannel(connection, largest_body=STRANGER)

    def _converse(
        self, connection: socket.socket, welcome: Callable[[socket.socket], StreamChannel], caller: Caller
    ) -> None:
        """Answer one connection until it ends."""
        try:
            channel = welcome(connection)
        except (OSError, VlagentsError) as error:
            _log.warning("%s was refused: %s", caller.name, error)
            connection.close()
            return
        with self._lock:
            self._open.add(channel)
        try:
            while not self._is_closing.is_set():
                self._answer_one(channel, caller)
        except ConnectionLost:
            pass
        except VlagentsError as error:
            if not self._is_closing.is_set():
                _log.warning("The connection of %s was ended: %s", caller.name, error)
        finally:
            with self._lock:
                self._open.discard(channel)
            channel.close()
            self.service.forget(caller)

    def _answer_one(self, channel: StreamChannel, caller: Caller) -> None:
        begin = None if caller.is_known else BEGIN
        values = channel.receive(Deadline(begin, "hello"), Deadline(self._transfer, "the rest of a message"))
        number = values.get("id") if isinstance(values, dict) else None
        send = Deadline(self._transfer, "reading of an answer")
        try:
            answer = self.service.answer(caller, values)
            if isinstance(channel, SharedChannel):
                channel.check()
        except (BadMessage, Unauthorized) as error:
            with contextlib.suppress(VlagentsError):
                channel.send(failure(number, error), send)
            raise
        channel.largest_body = self._largest_body if caller.is_known else STRANGER
        channel.send(answer, send)


def _family(host: str) -> socket.AddressFamily:
    return socket.AF_INET6 if ":" in host else socket.AF_INET
