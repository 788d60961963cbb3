"""The part that clients of other projects' servers share: these say little about their policies, so the user does."""

from __future__ import annotations

import threading
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vlagents.address import Address, parse
from vlagents.chunk import Chunk
from vlagents.errors import BadMessage, InvalidInput, Mismatch
from vlagents.metadata import Metadata, Offer, differences
from vlagents.observation import Observation
from vlagents.policies.sessions import SessionPolicy
from vlagents.record import positive


class ForeignClient(SessionPolicy[None]):
    """Calls a server of another project. After one that is late or gone, the next call connects again."""

    def __init__(
        self,
        address: str,
        *,
        timeout: float = 5.0,
        token: str | None = None,
        offer: Offer | None = None,
        metadata: Metadata | None = None,
        period: float | None = None,
        certificate: None = None,
    ) -> None:
        """Set what the server does not say; a subclass connects.

        Args:
            address: Where the server is.
            timeout: How long an answer may take [s].
            token: The server's secret.
            offer: What the robot shows and takes; None to compare nothing.
            metadata: What the policy needs and gives; without it, any actions are accepted.
            period: Time that each row of a chunk is for [s], where the metadata have no rate.
            certificate: None; these wires have no TLS.

        Raises:
            InvalidInput: An option is wrong, or there is no period.
            Mismatch: Robot and policy do not fit.
        """
        if certificate is not None:
            raise InvalidInput(f"{address} has no TLS; leave out the certificate.")
        self.address: Address = parse(address)
        self.timeout = positive("timeout", timeout)
        """How long an answer may take [s]."""
        self._token = token
        super().__init__(metadata or Metadata(name=self.address.scheme, action=()))
        rate = self._metadata.rate
        if period is None and rate <= 0:
            raise InvalidInput(f"{address} does not say what time an action is for; give `period`, or a rate.")
        self._period = 1.0 / rate if period is None else float(period)
        if offer is not None and self._metadata.action and (found := differences(self._metadata, offer)):
            raise Mismatch(found)
        self._lock = threading.Lock()

    def infer(self, observation: Observation) -> Chunk:
        """Return the policy's chunk for an observation.

        Raises:
            ConnectionLost: No server is there, or it has gone.
            DeadlineExceeded: It did not answer in time.
            InvalidInput: The observation is not what this wire takes.
            BadMessage: The answer is no chunk.
            PolicyFailed: The policy failed.
        """
        instruction = observation.instruction or self._session(observation).instruction
        with self._lock:
            actions = self._ask(observation, instruction)
        size = self._metadata.size
        if size and actions.shape[-1] != size:
            raise BadMessage(f"{self.address} gave actions of {actions.shape[-1]} numbers; the metadata say {size}.")
        try:
            return Chunk(np.array(actions, np.float64), self._period, observation.time)
        except InvalidInput as error:
            raise BadMessage(f"The answer of {self.address} is no chunk: {error}") from error

    @abstractmethod
    def _ask(self, observation: Observation, instruction: str) -> NDArray[Any]:
        """Return the actions (horizon, size) for an observation."""


def side_by_side(parts: Mapping[str, Any], metadata: Metadata, address: object) -> NDArray[Any]:
    """Return parts of actions, (horizon, size) each, as the columns of one array, in the order of the metadata.

    Raises:
        BadMessage: A part is missing, or is no such array.
    """
    names = [part.name for part in metadata.action] or list(parts)
    columns = []
    for name in names:
        part = parts.get(name)
        if not isinstance(part, np.ndarray) or part.dtype.kind not in "fiu" or part.ndim != 2:
            raise BadMessage(
                f"The answer of {address} has no {name!r} of shape (horizon, size); it has {sorted(parts)}."
            )
        columns.append(part)
    if not columns or len({len(part) for part in columns}) != 1:
        raise BadMessage(
            f"The answer of {address} has parts of {[len(part) for part in columns]} rows; valid: one number."
        )
    return np.concatenate(columns, axis=1)
