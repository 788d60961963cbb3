"""A policy in another process or on another machine: the same interface, over a wire."""

from __future__ import annotations

import contextlib
import os
import socket
from dataclasses import replace
from typing import Any

from vlagents.address import is_loopback
from vlagents.chunk import Chunk
from vlagents.errors import (
    BadMessage,
    ConnectionLost,
    DeadlineExceeded,
    InvalidInput,
    Unauthorized,
    VlagentsError,
    from_failure,
)
from vlagents.metadata import Metadata
from vlagents.observation import Observation
from vlagents.remote import RemotePolicy
from vlagents.wire.calls import VERSION, chunk_from_values, observation_to_values
from vlagents.wire.link import Deadline, Link, dial
from vlagents.wire.shared import SLOTS, SharedChannel, UnixLink, is_supported, name_beside, peer_user
from vlagents.wire.stream import StreamChannel


class Client(RemotePolicy):
    """Calls the policy of a `Server`.

    On the server's machine, arrays go through shared memory, which the client finds by itself. A call whose answer is
    late raises `DeadlineExceeded`; the answer is discarded when it arrives, and the session continues.
    """

    schemes = ("vla", "vlas")
    _channel: StreamChannel | None

    def __init__(self, address: str, *, is_shared: bool | None = None, **options: Any) -> None:
        """Connect, and compare what the robot offers with what the policy needs.

        Args:
            address: `vla://host:port`, or `vlas://host:port` with TLS.
            is_shared: True to require shared memory for arrays, False to do without, None to use it where possible.
            options: Options of `RemotePolicy`.

        Raises:
            InvalidInput: The address is not valid.
            ConnectionLost: There is no server, or no shared memory where it is required.
            DeadlineExceeded: The server does not answer.
            Unauthorized: The token is wrong.
            Mismatch: The robot and the policy do not fit each other.
        """
        self._is_shared = is_shared
        self._number = 0
        self._late: set[int] = set()
        super().__init__(address, **options)

    @property
    def is_shared(self) -> bool:
        """True if arrays go through shared memory."""
        return isinstance(self._channel, SharedChannel)

    def ping(self) -> dict[str, Any]:
        """Return the server's health: its policy, its version, its running time, its number of answers."""
        health = self.call("ping").get("health")
        if not isinstance(health, dict):
            raise BadMessage("The answer to ping has no health.")
        return health

    def _tell(self, call: str, **given: Any) -> None:
        self.call(call, **given)

    def _infer(self, observation: Observation) -> Chunk:
        return chunk_from_values(self.call("infer", observation=observation_to_values(observation)).get("chunk"))

    def call(self, call: str, **given: Any) -> dict[str, Any]:
        """Return the answer to a call; its arrays are the caller's to keep."""
        with self._lock:
            return self._ask_over(self._connected(), call, given)

    def _ask_over(self, channel: StreamChannel, call: str, given: dict[str, Any]) -> dict[str, Any]:
        deadline = Deadline(self.timeout, f"The answer of {self.address}")
        while len(self._late) >= SLOTS:  # both slots of shared memory may still be read
            self._take(channel, deadline)
        if not self._late:
            channel.settled()
        self._number += 1
        number = self._number
        try:
            channel.send({"call": call, "id": number, "within": self.timeout, **given}, deadline)
        except InvalidInput:
            raise
        except VlagentsError:
            self._lose(channel)
            raise
        self._late.add(number)
        while True:
            answer = self._take(channel, deadline)
            if answer.get("id") == number:
                break
        if "error" in answer:
            error = from_failure(answer["error"])
            if isinstance(error, (BadMessage, Unauthorized)):
                self._lose(channel)
            raise error
        return answer

    def _take(self, channel: StreamChannel, deadline: Deadline) -> dict[str, Any]:
        """Return the next answer, to any call."""
        try:
            if not channel.wait(deadline.left()):
                raise deadline.exceeded()
        except (OSError, ValueError) as error:
            if isinstance(error, DeadlineExceeded):
                raise
            self._lose(channel)
            raise ConnectionLost(f"The connection broke: {error}.") from error
        try:
            # An answer that begins must arrive as a whole, or the connection is out of step.
            answer = channel.receive(Deadline(self.timeout, "The rest of an answer"))
        except VlagentsError:
            self._lose(channel)
            raise
        number = answer.get("id")
        if not isinstance(number, int):
            self._lose(channel)
            if number is None:  # the server could not read the call
                raise from_failure(answer.get("error"))
            raise BadMessage(f"{self.address} sent something that is no answer.")
        self._late.discard(number)
        return answer

    def _connect(self) -> None:
        channel = self._open()
        self._number, self._late = 0, set()
        try:
            answer = self._ask_over(channel, "hello", {"version": VERSION, "token": self._token})
            self._metadata = Metadata.from_dict(answer.get("metadata"))
        except DeadlineExceeded as error:
            channel.close()
            if isinstance(channel, SharedChannel):
                raise
            other = replace(self.address, scheme="wss" if self.address.scheme == "vlas" else "ws")
            raise DeadlineExceeded(f"{error} If it serves a websocket, its address is {other}.") from error
        except ConnectionLost as error:
            channel.close()
            if isinstance(channel, SharedChannel) or self.address.scheme == "vlas":
                raise
            other = replace(self.address, scheme="vlas")
            raise ConnectionLost(f"{error} If it serves TLS, its address is {other}.") from error
        except BaseException:
            channel.close()
            raise
        self._channel = channel

    def _open(self) -> StreamChannel:
        address = self.address
        if self._is_shared is not False and address.scheme == "vla" and is_loopback(address.host) and is_supported():
            with contextlib.suppress(OSError):
                return self._open_shared()
        if self._is_shared:
            raise ConnectionLost(f"There is no shared memory to {address}: no server on this machine offers it there.")
        return StreamChannel(Link(dial(address, self.timeout, self._certificate)))

    def _open_shared(self) -> StreamChannel:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            connection.settimeout(self.timeout)
            connection.connect(name_beside(self.address))
            if peer_user(connection) != os.getuid():
                raise ConnectionLost("The Unix socket beside the port is another user's.")
        except OSError:
            connection.close()
            raise
        return SharedChannel(UnixLink(connection))
