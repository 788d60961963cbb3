"""Serves a policy over TCP, and over shared memory to whoever is on the same machine."""

from __future__ import annotations

import contextlib
import logging
import os
from collections.abc import Callable
from pathlib import Path
from types import TracebackType

from vlagents.address import Address, is_loopback
from vlagents.beside import listen_beside
from vlagents.errors import BadMessage, ConnectionLost, InvalidInput, Unauthorized, VlagentsError
from vlagents.listening import BEGIN, STRANGER, TRANSFER, Acceptor, Guest, Listening
from vlagents.policy import Policy
from vlagents.service import Caller, Service
from vlagents.wire.calls import failure
from vlagents.wire.deadline import Deadline
from vlagents.wire.shared import SharedChannel, is_supported, peer_user
from vlagents.wire.stream import LARGEST_BODY, StreamChannel

_log = logging.getLogger(__name__)


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
            host: As in `Listening`.
            port: As in `Listening`.
            token: As in `Listening`.
            certificate: As in `Listening`.
            key: As in `Listening`.
            largest_body: Most bytes of arrays in a message.
            transfer: How long a message may take to come once it began, and an answer to be read [s].

        Raises:
            InvalidInput: The address is open to others and there is no token, or TLS is half given.
        """
        self._listening = Listening(host=host, port=port, token=token, certificate=certificate, key=key)
        self._tls = self._listening.tls()
        self.service = Service(policy, token=token)
        self._largest_body, self._transfer = largest_body, transfer
        self._acceptor = Acceptor()
        self._port = port
        self._unix: Path | None = None

    @property
    def address(self) -> Address:
        """Where the server listens."""
        return Address("vla" if self._tls is None else "vlas", host=self._listening.host, port=self._port)

    @property
    def clients(self) -> int:
        """How many are connected."""
        return len(self._acceptor.open)

    def start(self) -> Server:
        """Listen, and answer in threads of its own.

        Raises:
            AddressTaken: Something listens there already.
            OSError: The port cannot be had.
        """
        listener = self._listening.open()
        self._port = listener.getsockname()[1]
        self._acceptor.listen(listener, lambda guest: self._converse(guest, self._over_tcp))
        if is_supported() and is_loopback(self._listening.host) and self._tls is None:
            self._listen_beside()
        return self

    def serve_forever(self) -> None:
        """Wait until `close` is called, from another thread or a signal's handler."""
        self._acceptor.is_closing.wait()

    def close(self) -> None:
        """End all connections, then close the policy, as `Service.close` does. A second call does nothing."""
        path, self._unix = self._unix, None
        if path is not None:
            path.unlink(missing_ok=True)
        self._acceptor.close()
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
            listener, self._unix = listen_beside(self._port)
        except (OSError, InvalidInput) as error:
            _log.warning("There is no shared memory for clients on this machine: %s", error)
            return
        self._acceptor.listen(listener, lambda guest: self._converse(guest, self._over_memory))

    def _over_tcp(self, guest: Guest) -> StreamChannel:
        if self._tls is not None:
            guest.secure(self._tls)
        return StreamChannel(guest.connection, largest_body=STRANGER)

    def _over_memory(self, guest: Guest) -> StreamChannel:
        if peer_user(guest.connection) != os.getuid():
            raise Unauthorized("Somebody else is at the socket.")
        return SharedChannel(guest.connection, largest_body=STRANGER)

    def _converse(self, guest: Guest, welcome: Callable[[Guest], StreamChannel]) -> None:
        """Answer one connection until it ends."""
        caller = self.service.caller(guest.name)
        try:
            channel = welcome(guest)
        except (OSError, VlagentsError) as error:
            _log.warning("%s was refused: %s", guest.name, error)
            return
        self._acceptor.enter(channel)
        try:
            while not self._acceptor.is_closing.is_set():
                self._answer_one(channel, caller)
                guest.is_known = caller.is_known
        except ConnectionLost:
            pass
        except VlagentsError as error:
            if not self._acceptor.is_closing.is_set():
                _log.warning("The connection of %s was ended: %s", guest.name, error)
        finally:
            self._acceptor.leave(channel)
            channel.close()
            self.service.forget(caller)

    def _answer_one(self, channel: StreamChannel, caller: Caller) -> None:
        begin = None if caller.is_known else BEGIN
        values = channel.receive(Deadline(begin, "hello"), Deadline(self._transfer, "the rest of a message"))
        number = values.get("id") if isinstance(values, dict) else None
        try:
            answer = self.service.answer(caller, values)
        except (BadMessage, Unauthorized) as error:
            with contextlib.suppress(VlagentsError):
                channel.send(failure(number, error), Deadline(self._transfer, "reading of an answer"))
            raise
        channel.largest_body = self._largest_body if caller.is_known else STRANGER
        channel.send(answer, Deadline(self._transfer, "reading of an answer"))
