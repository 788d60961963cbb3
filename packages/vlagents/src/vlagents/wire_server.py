"""The part that servers of all wires share: where they listen, who may reach them, and a thread per connection."""

from __future__ import annotations

import contextlib
import errno
import logging
import socket
import ssl
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from vlagents.address import PORTS, Address, Scheme, is_loopback
from vlagents.errors import AddressTaken, ConnectionLost, InvalidInput, VlagentsError
from vlagents.policy import Policy
from vlagents.service import LEAVING, Caller, Service
from vlagents.wire.link import LARGEST_BODY, Channel, Deadline

_log = logging.getLogger(__name__)
S = TypeVar("S", bound="WireServer")

BEGIN = 5.0
"""Longest time until a new connection identifies itself [s]."""
TRANSFER = 10.0
"""Longest duration of a message from its first byte, and of the reading of an answer [s]."""
MOST_CALLERS = 64
"""Connections at a time."""
STRANGER = 64 << 10
"""Most bytes of arrays in a message of an unidentified client."""


@dataclass(eq=False, kw_only=True)
class Guest(Caller):
    """A client that has connected. When there are too many, the oldest that is not known gives way."""

    connection: socket.socket
    channel: Channel | None = None
    """The messages of the connection, while it is being answered."""

    def stop(self) -> None:
        """End the connection; the thread that reads or writes notices."""
        if self.channel is not None:
            self.channel.stop()
        with contextlib.suppress(OSError):
            # The base class's method: that of TLS forgets the encryption.
            socket.socket.shutdown(self.connection, socket.SHUT_RDWR)


class WireServer(ABC):
    """Takes connections and answers each in a thread of its own. A subclass knows a wire."""

    schemes: ClassVar[tuple[Scheme, Scheme | None]]
    """The address's scheme without and with TLS; None where the wire has no TLS."""

    def __init__(
        self,
        policy: Policy,
        *,
        host: str = "127.0.0.1",
        port: int | None = None,
        token: str | None = None,
        certificate: str | Path | None = None,
        key: str | Path | None = None,
        transfer: float = TRANSFER,
        largest: int = LARGEST_BODY,
    ) -> None:
        """Prepare; `start` or a `with` block opens the sockets.

        Args:
            policy: The policy to serve; it is closed with the server.
            host: Where to listen. Anything but this machine itself needs a token.
            port: TCP port; 0 for any that is free, None for the wire's own.
            token: The secret that clients must know; None for none. openpi's clients send it as `Authorization: Api-Key
                TOKEN`, OpenVLA's as `Authorization: Bearer TOKEN`, GR00T's as `api_token`.
            certificate: File with a certificate, for TLS.
            key: File with its key.
            transfer: How long a message may take to arrive once it began, and an answer to be read [s].
            largest: Most bytes of a message.

        Raises:
            InvalidInput: The address is open to others and there is no token, or TLS is incomplete.
            OSError: A file cannot be read.
        """
        if not is_loopback(host) and token is None:
            raise InvalidInput(
                f"The host {host!r} can be reached from other machines, and there is no token: anybody could call the "
                "policy. Give a token, or listen at 127.0.0.1."
            )
        if (certificate is None) != (key is None):
            raise InvalidInput("TLS needs both, certificate and key.")
        self._tls: ssl.SSLContext | None = None
        if certificate is not None:
            if self.schemes[1] is None:
                raise InvalidInput(f"The wire {self.schemes[0]!r} has no TLS; leave out certificate and key.")
            self._tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            self._tls.load_cert_chain(certificate, key)
        self.service = Service(policy, token=token)
        self._host, self._port = host, PORTS[self.schemes[0]] if port is None else port
        self._transfer, self._largest = transfer, largest
        self._listeners: list[socket.socket] = []
        self._threads: list[threading.Thread] = []
        self._guests: dict[Guest, None] = {}
        self._lock = threading.Lock()
        self._is_closing = threading.Event()

    @property
    def address(self) -> Address:
        """The address at which the server listens."""
        scheme = self.schemes[0] if self._tls is None else self.schemes[1]
        assert scheme is not None
        return Address(scheme, host=self._host, port=self._port)

    @property
    def channels(self) -> list[Any]:
        """The channels of all connections that are being answered."""
        with self._lock:
            return [guest.channel for guest in self._guests if guest.channel is not None]

    def start(self: S) -> S:
        """Listen, and answer in threads of its own.

        Raises:
            AddressTaken: Something listens there already.
            OSError: The port is not available.
        """
        family = socket.AF_INET6 if ":" in self._host else socket.AF_INET
        try:
            listener = socket.create_server((self._host, self._port), family=family, backlog=2 * MOST_CALLERS)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            raise AddressTaken(self.address) from error
        self._port = listener.getsockname()[1]
        self._start_more()
        self._listen(listener, self._open)
        return self

    def serve_forever(self) -> None:
        """Wait until `close` is called, from another thread or a signal's handler."""
        self._is_closing.wait()

    def close(self) -> None:
        """End all connections, then close the policy, as `Service.close` does. A second call does nothing.

        A connection that has not ended after `LEAVING` seconds, because the policy still works on it, is left alone.
        """
        self._is_closing.set()
        for listener in self._listeners:
            with contextlib.suppress(OSError):
                listener.shutdown(socket.SHUT_RDWR)  # wakes the thread that waits there
            listener.close()
        with self._lock:
            guests = list(self._guests)
        for guest in guests:
            guest.stop()
        end = time.monotonic() + LEAVING
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(max(end - time.monotonic(), 0.0))
        self.service.close()

    def __enter__(self: S) -> S:
        """Start."""
        return self.start()

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()

    @abstractmethod
    def _open(self, guest: Guest) -> Channel | None:
        """Return the messages of a new connection; None if it is over already."""

    def _answer_one(self, guest: Guest, channel: Any) -> None:
        """Receive a message and answer it, and mark the guest as known once it has the token."""
        raise NotImplementedError

    def _start_more(self) -> None:  # noqa: B027  most wires have nothing more
        """Start whatever a wire has beside its port."""

    def _rest(self) -> Deadline:
        """Return by when a message that begins now must have arrived, or an answer been read."""
        return Deadline(self._transfer, "the rest of a message")

    def _listen(self, listener: socket.socket, open_channel: Callable[[Guest], Channel | None]) -> None:
        self._listeners.append(listener)
        self._run(f"vlagents accept {listener.getsockname()}", self._accept, listener, open_channel)

    def _run(self, name: str, act: Callable[..., None], *arguments: Any) -> None:
        """Run a function in a thread of its own, which `close` waits for."""
        thread = threading.Thread(target=act, args=arguments, name=name, daemon=True)
        with self._lock:
            self._threads = [other for other in self._threads if other.is_alive()]
            self._threads.append(thread)
        thread.start()

    def _accept(self, listener: socket.socket, open_channel: Callable[[Guest], Channel | None]) -> None:
        while not self._is_closing.is_set():
            try:
                connection, peer = listener.accept()
            except OSError:
                if self._is_closing.wait(0.05):  # out of files: other connections may end soon
                    return
                continue
            name = f"{peer[0]}:{peer[1]}" if isinstance(peer, tuple) else "this machine"
            guest = Guest(name=name, connection=connection)
            if not self._seat(guest):
                _log.warning("%s was refused: there are %d connections already", guest.name, MOST_CALLERS)
                connection.close()
                continue
            self._run(f"vlagents with {guest.name}", self._answer_guest, guest, open_channel)

    def _seat(self, guest: Guest) -> bool:
        """Return whether there is room for a client, if need be because an unknown one has to go."""
        with self._lock:
            if len(self._guests) >= MOST_CALLERS:
                silent = next((other for other in self._guests if not other.is_known), None)
                if silent is None:
                    return False
                _log.warning("%s has not identified itself, and gave way to %s", silent.name, guest.name)
                del self._guests[silent]
                silent.stop()
            self._guests[guest] = None
            return True

    def _answer_guest(self, guest: Guest, open_channel: Callable[[Guest], Channel | None]) -> None:
        try:
            if self._tls is not None:
                guest.connection.settimeout(BEGIN)
                # The handshake follows the replacement of the connection, so that `stop` ends it, too.
                encrypted = self._tls.wrap_socket(guest.connection, server_side=True, do_handshake_on_connect=False)
                guest.connection = encrypted
                encrypted.do_handshake()
            channel = open_channel(guest)
            if channel is not None:
                self._converse(guest, channel)
        except (OSError, ValueError, VlagentsError) as error:
            _log.warning("%s was refused: %s", guest.name, error)
        finally:
            with self._lock:
                self._guests.pop(guest, None)
            guest.connection.close()

    def _converse(self, guest: Guest, channel: Channel) -> None:
        """Answer a guest until it leaves or breaks a rule, and have the policy forget its sessions."""
        guest.channel = channel
        try:
            if self._is_closing.is_set():
                channel.stop()
            while not self._is_closing.is_set():
                self._answer_one(guest, channel)
        except ConnectionLost:
            pass
        except VlagentsError as error:
            if not self._is_closing.is_set():
                _log.warning("The connection of %s was ended: %s", guest.name, error)
        finally:
            guest.channel = None
            channel.close()
            self.service.forget(guest)
