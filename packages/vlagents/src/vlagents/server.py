"""Serves a policy over TCP, and over shared memory to clients on the same machine."""

from __future__ import annotations

import contextlib
import logging
import os
from pathlib import Path
from typing import Any

from vlagents.address import is_loopback
from vlagents.errors import BadMessage, InvalidInput, Unauthorized, VlagentsError
from vlagents.policy import Policy
from vlagents.service import Caller
from vlagents.wire.calls import failure
from vlagents.wire.link import Deadline
from vlagents.wire.local_socket import listen_beside
from vlagents.wire.shared import SharedChannel, is_supported, peer_user
from vlagents.wire.stream import LARGEST_BODY, StreamChannel
from vlagents.wire_server import BEGIN, STRANGER, Guest, WireServer

_log = logging.getLogger(__name__)


class Server(WireServer):
    """Answers calls over TCP at one address, and over a Unix socket with shared memory beside it.

    Example:
        >>> from vlagents import Client, Observation, Server
        >>> from vlagents.policies.random import RandomPolicy
        >>> with Server(RandomPolicy(size=7), port=0) as server, Client(str(server.address)) as client:
        ...     client.infer(Observation()).actions.shape
        (1, 7)
    """

    schemes = ("vla", "vlas")
    _unix: Path | None = None

    def __init__(self, policy: Policy, *, port: int = 8090, largest_body: int = LARGEST_BODY, **options: Any) -> None:
        """Prepare; `start` or a `with` block opens the sockets.

        Args:
            policy: The policy to serve; it is closed with the server.
            port: TCP port; 0 for any that is free.
            largest_body: Most bytes of arrays in a message.
            options: `host`, `token`, `certificate`, `key` and `transfer`, as of `WireServer`.

        Raises:
            InvalidInput: The address is open to others and there is no token, or TLS is incomplete.
        """
        super().__init__(policy, port=port, **options)
        self._largest_body = largest_body

    def start(self) -> Server:
        """Listen, and answer in threads of its own.

        Raises:
            AddressTaken: Something listens there already.
            OSError: The port is not available.
        """
        super().start()
        if is_supported() and is_loopback(self._host) and self._tls is None:
            try:
                listener, self._unix = listen_beside(self._port)
                self._listen(listener, self._converse_beside)
            except (OSError, InvalidInput) as error:
                _log.warning("There is no shared memory for clients on this machine: %s", error)
        return self

    def close(self) -> None:
        """End all connections, then close the policy, as `Service.close` does. A second call does nothing."""
        path, self._unix = self._unix, None
        if path is not None:
            path.unlink(missing_ok=True)
        super().close()

    def _converse(self, guest: Guest) -> None:
        try:
            guest.secure(self._tls)
        except OSError as error:
            _log.warning("%s was refused: %s", guest.name, error)
            return
        self._answer_all(guest, StreamChannel(guest.connection, largest_body=STRANGER))

    def _converse_beside(self, guest: Guest) -> None:
        if peer_user(guest.connection) != os.getuid():
            _log.warning("%s was refused: another user is at the socket", guest.name)
            return
        self._answer_all(guest, SharedChannel(guest.connection, largest_body=STRANGER))

    def _answer_all(self, guest: Guest, channel: StreamChannel) -> None:
        caller = self.service.caller(guest.name)
        try:
            with self._conversation(guest, channel):
                while not self._is_closing.is_set():
                    self._answer_one(channel, caller)
                    guest.is_known = caller.is_known
        finally:
            self.service.forget(caller)

    def _answer_one(self, channel: StreamChannel, caller: Caller) -> None:
        begin = None if caller.is_known else BEGIN
        values = channel.receive(Deadline(begin, "hello"), Deadline(self._transfer, "the rest of a message"))
        try:
            answer = self.service.answer(caller, values)
        except (BadMessage, Unauthorized) as error:
            with contextlib.suppress(VlagentsError):
                channel.send(failure(values.get("id"), error), Deadline(self._transfer, "reading of an answer"))
            raise
        channel.largest_body = self._largest_body if caller.is_known else STRANGER
        channel.send(answer, Deadline(self._transfer, "reading of an answer"))
