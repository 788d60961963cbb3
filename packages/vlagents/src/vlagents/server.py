"""Serves a policy over TCP, and over shared memory to clients on the same machine."""

from __future__ import annotations

import contextlib
import logging
import os
import socket

from vlagents.address import is_loopback
from vlagents.errors import BadMessage, Unauthorized, VlagentsError, as_failure
from vlagents.wire.link import Deadline, Link
from vlagents.wire.shared import SharedChannel, UnixLink, is_supported, name_beside, peer_user
from vlagents.wire.stream import StreamChannel
from vlagents.wire_server import BEGIN, STRANGER, Guest, WireServer

_log = logging.getLogger(__name__)


class Server(WireServer):
    """Answers calls over TCP at one address, and over a Unix socket with shared memory beside it.

    Examples:
        >>> from vlagents import Client, Observation, Server
        >>> from vlagents.policies.random import RandomPolicy
        >>> with Server(RandomPolicy(size=7), port=0) as server, Client(str(server.address)) as client:
        ...     client.infer(Observation()).actions.shape
        (1, 7)
    """

    schemes = ("vla", "vlas")

    def _start_more(self) -> None:
        if is_supported() and is_loopback(self._host) and self._tls is None:
            listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            try:
                listener.bind(name_beside(self.address))
                listener.listen(16)
                self._listen(listener, self._open_beside)
            except OSError as error:
                listener.close()
                _log.warning("There is no shared memory for clients on this machine: %s", error)

    def _open(self, guest: Guest) -> StreamChannel:
        return StreamChannel(Link(guest.connection), largest=STRANGER)

    def _open_beside(self, guest: Guest) -> SharedChannel:
        if peer_user(guest.connection) != os.getuid():
            raise Unauthorized("another user is at the socket")
        return SharedChannel(UnixLink(guest.connection), largest=STRANGER)

    def _answer_one(self, guest: Guest, channel: StreamChannel) -> None:
        begin = None if guest.is_known else BEGIN
        values = channel.receive(Deadline(begin, "hello"), self._rest())
        try:
            answer = self.service.answer(guest, values)
        except (BadMessage, Unauthorized) as error:
            with contextlib.suppress(VlagentsError):
                channel.send({"id": values.get("id"), "error": as_failure(error)}, self._rest())
            raise
        channel.largest = self._largest if guest.is_known else STRANGER
        channel.send(answer, self._rest())
