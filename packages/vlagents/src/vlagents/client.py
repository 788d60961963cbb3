"""A policy in another process or on another machine: the same interface, over a wire."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

from vlagents.address import Address, is_loopback, parse
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
from vlagents.metadata import Metadata, Offer
from vlagents.observation import Observation
from vlagents.policy import Policy
from vlagents.record import positive
from vlagents.wire.calls import VERSION, chunk_from_values, observation_to_values
from vlagents.wire.link import Deadline, dial
from vlagents.wire.local_socket import is_own_socket, socket_beside
from vlagents.wire.shared import SLOTS, SharedChannel, is_supported, peer_user
from vlagents.wire.stream import LARGEST_BODY, StreamChannel


class Client(Policy):
    """Calls the policy of a `Server`.

    On the server's machine, arrays go through shared memory; the client finds out by itself. A late answer raises
    `DeadlineExceeded` and is discarded when it arrives; the session continues. After `ConnectionLost` only `reset`
    connects again: the program that drives a robot must know that its policy was gone.
    """

    def __init__(
        self,
        address: str,
        *,
        token: str | None = None,
        timeout: float = 5.0,
        offer: Offer | None = None,
        certificate: str | Path | None = None,
        is_shared: bool | None = None,
    ) -> None:
        """Connect, and compare what the robot offers with what the policy needs.

        Args:
            address: `vla://host:port`, `vlas://host:port` or `unix:///path`.
            token: The server's secret.
            timeout: How long an answer may take [s].
            offer: What the robot shows and takes; None to compare nothing.
            certificate: File with the certificate that the server's must be signed by; None for those of the system.
            is_shared: Whether arrays go through shared memory; None where it can be.

        Raises:
            InvalidInput: The address is not valid.
            ConnectionLost: No server is there.
            DeadlineExceeded: It does not answer.
            Unauthorized: The token is wrong.
            Mismatch: Robot and policy do not fit.
        """
        self.address: Address = parse(address)
        if self.address.scheme not in ("vla", "vlas", "unix"):
            raise InvalidInput(f"{address!r} is of another wire; vlagents.connect returns a client for it.")
        self.timeout = positive("timeout", timeout)
        """How long an answer may take [s]."""
        self._token, self._offer = token, offer
        self._certificate, self._is_shared = certificate, is_shared
        self._channel: StreamChannel | None = None
        self._lock = threading.RLock()
        self._number = 0
        self._late: set[int] = set()
        self._metadata = self._connect()

    @property
    def is_shared(self) -> bool:
        """Whether arrays go through shared memory."""
        return isinstance(self._channel, SharedChannel)

    def metadata(self) -> Metadata:
        """Return the metadata as of the connection."""
        return self._metadata

    def infer(self, observation: Observation) -> Chunk:
        """Return the policy's chunk for an observation.

        Raises:
            ConnectionLost: The server has gone.
            DeadlineExceeded: It did not answer in time.
            InvalidInput: The observation is not what the policy takes.
            PolicyFailed: The policy raised an error.
        """
        values = observation_to_values(observation)
        with self._lock:  # until the chunk is copied out of the answer's memory
            return chunk_from_values(self._ask("infer", observation=values).get("chunk"))

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        """Begin an episode; connect again if the server was gone."""
        with self._lock:
            if self._channel is None:
                self._metadata = self._connect()
        self._ask("reset", session=session, instruction=instruction, seed=seed)

    def forget(self, session: str) -> None:
        """Have the server forget a session."""
        self._ask("forget", session=session)

    def ping(self) -> dict[str, Any]:
        """Return the server's health: its policy, its version, its running time, its number of answers."""
        health = self._ask("ping").get("health")
        if not isinstance(health, dict):
            raise BadMessage("The answer to ping has no health.")
        return health

    def close(self) -> None:
        """End the connection. The server forgets this client's sessions."""
        channel, self._channel = self._channel, None
        if channel is not None:
            channel.close()

    def _ask(self, call: str, **given: Any) -> dict[str, Any]:
        with self._lock:
            channel = self._channel
            if channel is None:
                raise ConnectionLost(f"There is no connection to {self.address}; `reset` connects again.")
            return self._ask_over(channel, call, given)

    def _ask_over(self, channel: StreamChannel, call: str, given: dict[str, Any]) -> dict[str, Any]:
        deadline = Deadline(self.timeout, f"The answer of {self.address}")
        while len(self._late) >= SLOTS:  # of shared memory, both slots may still be read
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
        """Return the next answer, to whichever call it is."""
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
        if not (answer.get("id") is None or isinstance(answer.get("id"), int)):
            self._lose(channel)
            raise BadMessage(f"{self.address} sent something that is no answer.")
        if answer.get("id") is None:
            self._lose(channel)
            raise from_failure(answer.get("error"))
        self._late.discard(answer["id"])
        return answer

    def _lose(self, channel: StreamChannel) -> None:
        channel.close()
        if self._channel is channel:
            self._channel = None

    def _connect(self) -> Metadata:
        channel = self._open()
        self._number, self._late = 0, set()
        offer = None if self._offer is None else self._offer.to_dict()
        try:
            answer = self._ask_over(channel, "hello", {"version": VERSION, "token": self._token, "offer": offer})
            metadata = Metadata.from_dict(answer.get("metadata"))
        except DeadlineExceeded as error:
            channel.close()
            if isinstance(channel, SharedChannel):
                raise
            other = replace(self.address, scheme="wss" if self.address.scheme == "vlas" else "ws")
            raise DeadlineExceeded(f"{error} If it serves a websocket, its address is {other}.") from error
        except BaseException:
            channel.close()
            raise
        self._channel = channel
        return metadata

    def _open(self) -> StreamChannel:
        address = self.address
        if address.scheme == "unix":
            return self._open_shared(Path(address.path))
        if self._is_shared is not False and address.scheme == "vla" and is_loopback(address.host) and is_supported():
            with contextlib.suppress(OSError, InvalidInput):
                path = socket_beside(address.port)
                if is_own_socket(path):
                    return self._open_shared(path)
        if self._is_shared:
            raise ConnectionLost(f"There is no shared memory to {address}: no server on this machine offers it there.")
        return StreamChannel(dial(address, self.timeout, self._certificate), largest_body=LARGEST_BODY)

    def _open_shared(self, path: Path) -> StreamChannel:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            connection.settimeout(self.timeout)
            connection.connect(str(path))
            if peer_user(connection) != os.getuid():
                raise ConnectionLost(f"The server at {path} is another user's.")
        except OSError:
            connection.close()
            raise
        return SharedChannel(connection, largest_body=LARGEST_BODY)
