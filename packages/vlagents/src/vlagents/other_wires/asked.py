"""What clients of other servers share: those tell little about their policies, so whoever asks must know it."""

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
from vlagents.policy import Policy


class Asked(Policy):
    """Asks a server of another kind. One that is late or goes leaves nothing behind: the next call begins anew."""

    def __init__(
        self,
        address: str,
        *,
        timeout: float = 5.0,
        token: str | None = None,
        offer: Offer | None = None,
        metadata: Metadata | None = None,
        period: float | None = None,
    ) -> None:
        """Set what the server does not tell; a subclass connects.

        Args:
            address: Where the server is.
            timeout: How long an answer may take [s].
            token: What it wants to hear.
            offer: What the robot shows and takes; None to compare nothing.
            metadata: What the policy needs and gives; without, whatever comes is taken.
            period: Time that each row of a chunk is for [s], where the metadata have no rate.

        Raises:
            InvalidInput: An option is wrong, or there is no period.
            Mismatch: Robot and policy do not fit.
        """
        if not (isinstance(timeout, (int, float)) and 0 < timeout < float("inf")):
            raise InvalidInput(f"timeout is {timeout!r}; valid is a number of seconds above 0.")
        self.address: Address = parse(address)
        self.timeout = float(timeout)
        """How long an answer may take [s]."""
        self._token = token
        self._metadata = metadata or Metadata(name=self.address.scheme, action=())
        rate = self._metadata.rate
        if period is None and rate <= 0:
            raise InvalidInput(f"{address} does not tell what time an action is for; give `period`, or a rate.")
        self._period = 1.0 / rate if period is None else float(period)
        if offer is not None and self._metadata.action and (found := differences(self._metadata, offer)):
            raise Mismatch(found)
        self._lock = threading.Lock()
        self._told: dict[str, str] = {}

    def metadata(self) -> Metadata:
        """Return what was given."""
        return self._metadata

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        """Remember what is to be done in a session."""
        self._told[session] = instruction

    def forget(self, session: str) -> None:
        """Let go of a session's instruction."""
        self._told.pop(session, None)

    def infer(self, observation: Observation) -> Chunk:
        """Return the policy's chunk for an observation.

        Raises:
            ConnectionLost: Nobody is there, or the server has gone.
            DeadlineExceeded: It did not answer in time.
            InvalidInput: The observation is not what this wire takes.
            BadMessage: The answer is none.
            PolicyFailed: The server says that it failed.
        """
        instruction = observation.instruction or self._told.get(observation.session, "")
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
        BadMessage: One is missing, or is no such array.
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
