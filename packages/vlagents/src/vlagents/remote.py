"""A policy at an address: the part that the clients of all wires share, and the choice of a client by address."""

from __future__ import annotations

import pkgutil
import threading
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from vlagents.address import Address, Scheme, parse
from vlagents.chunk import Chunk
from vlagents.errors import BadMessage, ConnectionLost, InvalidInput, Mismatch
from vlagents.metadata import Metadata, Offer, differences
from vlagents.observation import Observation
from vlagents.policy import Policy
from vlagents.record import positive

CLIENTS = {
    "vla": "vlagents.client:Client",
    "vlas": "vlagents.client:Client",
    "ws": "vlagents.websocket:WebsocketClient",
    "wss": "vlagents.websocket:WebsocketClient",
    "gr00t": "vlagents.other_wires.groot:GrootClient",
    "openvla+http": "vlagents.other_wires.openvla:OpenvlaClient",
}
"""The class of each scheme; a module is imported when it is used."""


def connect(address: str, **options: Any) -> Any:
    """Return a client of the class that the address's scheme has in `CLIENTS`.

    Args:
        address: Where the server is.
        options: As of `RemotePolicy`, and more of some classes.

    Raises:
        InvalidInput: The address or an option is wrong.
        ConnectionLost: No server is there.
        DeadlineExceeded: It does not answer.
        Unauthorized: The token is wrong.
        Mismatch: Robot and policy do not fit.
    """
    return pkgutil.resolve_name(CLIENTS[parse(address).scheme])(address, **options)


class RemotePolicy(Policy):
    """A policy at an address; a subclass knows a wire.

    After `ConnectionLost` only `reset` connects again: the program that drives a robot must know that its policy was
    gone.
    """

    schemes: ClassVar[tuple[Scheme, ...]]
    """The schemes of addresses of this wire."""

    def __init__(
        self,
        address: str,
        *,
        token: str | None = None,
        timeout: float = 5.0,
        offer: Offer | None = None,
        metadata: Metadata | None = None,
        period: float | None = None,
        certificate: str | Path | None = None,
    ) -> None:
        """Connect, and compare what the robot offers with what the policy needs.

        Args:
            address: Where the server is.
            token: The server's secret.
            timeout: How long an answer may take [s].
            offer: Description of what the robot shows and takes; None to compare nothing.
            metadata: Description of what the policy needs and gives, where the server does not say: those of other
                projects do not. Without it, any actions are accepted.
            period: Time that each row of a chunk is for [s], where neither server nor metadata say.
            certificate: File with the certificate that the server's must be signed by; None for those of the system.

        Raises:
            InvalidInput: The address or an option is not valid.
            ConnectionLost: No server is there.
            DeadlineExceeded: It does not answer.
            Unauthorized: The token is wrong.
            Mismatch: Robot and policy do not fit.
        """
        self.address: Address = parse(address)
        if self.address.scheme not in self.schemes:
            raise InvalidInput(f"{address!r} is of another wire; vlagents.connect returns a client for it.")
        if certificate is not None and self.address.scheme not in ("vlas", "wss"):
            raise InvalidInput(f"{address} has no TLS; leave out the certificate.")
        self.timeout = positive("timeout", timeout)
        """Longest duration of an answer [s]."""
        self._token, self._certificate = token, certificate
        self._metadata = metadata or Metadata(name=self.address.scheme, action=())
        self._instructions: dict[str, str] = {}
        self._lock = threading.RLock()
        self._channel: Any = None
        self._period = None if period is None else positive("period", period)
        self._offer = offer
        self._connect_to_fitting()

    def metadata(self) -> Metadata:
        """Return the server's metadata as of the connection, or those that stand in for them."""
        return self._metadata

    def infer(self, observation: Observation) -> Chunk:
        """Return the policy's chunk for an observation.

        Raises:
            ConnectionLost: The server has gone.
            DeadlineExceeded: It did not answer in time. Where answers have no number, the connection is closed.
            InvalidInput: The observation is not what the policy or the wire takes, or there is no period.
            BadMessage: The answer is no chunk.
            PolicyFailed: The policy failed.
        """
        with self._lock:
            return self._infer(observation)

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        """Begin an episode; connect again if the server was gone.

        Raises:
            Mismatch: The policy that is there now does not fit the robot.
        """
        with self._lock:
            self._instructions[session] = instruction
            if self._channel is None:
                self._connect_to_fitting()
            self._tell("reset", session=session, instruction=instruction, seed=seed)

    def forget(self, session: str) -> None:
        """Forget a session, here and on a server that remembers it."""
        self._instructions.pop(session, None)
        self._tell("forget", session=session)

    def close(self) -> None:
        """End the connection. A server of vlagents forgets this client's sessions."""
        channel, self._channel = self._channel, None
        if channel is not None:
            channel.close()

    def _connect_to_fitting(self) -> None:
        """Connect, and end the connection if the policy does not fit what the robot offers."""
        self._connect()
        if self._offer is not None and self._metadata.action and (found := differences(self._metadata, self._offer)):
            RemotePolicy.close(self)  # a subclass's ends its threads, too; `reset` may find another server
            raise Mismatch(found)

    @abstractmethod
    def _connect(self) -> None:
        """Open a connection, and take over the metadata that the server sends."""

    @abstractmethod
    def _infer(self, observation: Observation) -> Chunk:
        """Return the policy's chunk for an observation."""

    def _tell(self, call: str, **given: Any) -> None:
        """Pass `reset` or `forget` on to a server that remembers sessions; others need nothing."""

    def _connected(self) -> Any:
        if self._channel is None:
            raise ConnectionLost(f"There is no connection to {self.address}; `reset` connects again.")
        return self._channel

    def _lose(self, channel: Any) -> None:
        channel.close()
        if self._channel is channel:
            self._channel = None

    def _instructed(self, observation: Observation) -> Observation:
        """Return an observation with the instruction of its session's reset, if it has none of its own."""
        instruction = observation.instruction or self._instructions.get(observation.session, "")
        return observation if instruction == observation.instruction else replace(observation, instruction=instruction)

    def _chunk(self, actions: Any, time: float, info: Mapping[str, float] | None = None) -> Chunk:
        """Return the chunk of another project's actions, (horizon, size) or (size,).

        Raises:
            BadMessage: They are no actions, or have another size than the metadata say.
            InvalidInput: It is not known what time a row is for.
        """
        period = self._period or (1.0 / self._metadata.rate if self._metadata.rate else None)
        if period is None:
            raise InvalidInput(f"{self.address} does not say what time an action is for; give `period`, or a rate.")
        if not isinstance(actions, np.ndarray) or actions.ndim not in (1, 2) or actions.dtype.kind not in "fiu":
            raise BadMessage(f"The answer of {self.address} has no actions.")
        size = self._metadata.size
        if size and actions.shape[-1] != size:
            raise BadMessage(f"{self.address} gave actions of {actions.shape[-1]} numbers; the metadata say {size}.")
        try:
            return Chunk(np.atleast_2d(actions), period, time, info or {})
        except InvalidInput as error:
            raise BadMessage(f"The answer of {self.address} is no chunk: {error}") from error
