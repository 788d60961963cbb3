"""A simulator at an address: episodes and steps over the wire of policies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from vlagents.client import Client
from vlagents.errors import BadMessage, InvalidInput
from vlagents.metadata import Offer
from vlagents.simulators.interface import Facts, Moment, SimulatorMapping
from vlagents.wire.calls import observation_from_values


class SimulatorClient:
    """Opens a served simulator with a mapping, and runs episodes in it.

    Examples:
        >>> with SimulatorClient("vla://127.0.0.1:8090") as simulator:  # doctest: +SKIP
        ...     moment = simulator.begin(seed=0)
        ...     while not moment.is_over:
        ...         moment = simulator.advance(policy(moment.observation))
    """

    def __init__(self, address: str, mapping: SimulatorMapping | None = None, **options: Any) -> None:
        """Connect and open it.

        Args:
            address: `vla://host:port` or `vlas://host:port`.
            mapping: The mapping; None for the simulator's own.
            options: As of `RemotePolicy`; `timeout` holds for every call [s].

        Raises:
            InvalidInput: There is no simulator at the address, or the mapping does not fit it; the message has all
                differences.
            ConnectionLost: No server is there.
            DeadlineExceeded: It does not answer.
            Unauthorized: The token is wrong.
        """
        self._client = Client(address, **options)
        try:
            self.facts = Facts.from_dict(self._client.call("facts").get("facts"))
            """The facts that the simulator states about itself."""
            self.mapping = mapping or self.facts.mapping
            """The mapping between the simulator and policies."""
            self._opened = self._client.call("open", mapping=self.mapping.to_dict()).get("opened")
            self.offer: Offer = self.mapping.offer(self.facts)
            """The offer to a policy: what it is shown and what it may command."""
        except BaseException:
            self._client.close()
            raise

    def begin(self, seed: int) -> Moment:
        """Begin an episode; the same seed begins the same one.

        Raises:
            ConnectionLost: The simulator has gone.
            DeadlineExceeded: It did not answer in time.
            SimulatorTaken: Another client has opened it since.
            PolicyFailed: It raised an error.
            InvalidInput: It sent a number that is not finite.
        """
        return self._moment(self._client.call("begin", opened=self._opened, seed=seed))

    def advance(self, action: ArrayLike) -> Moment:
        """Make a step; errors are those of `begin`.

        Args:
            action: Numbers of the mapping's parts, side by side.
        """
        return self._moment(self._client.call("advance", opened=self._opened, action=np.asarray(action, np.float64)))

    def close(self) -> None:
        """End the connection; the server goes on. A second call does nothing."""
        self._client.close()

    def _moment(self, values: Mapping[str, Any]) -> Moment:
        seen, success = observation_from_values(values.get("observation")), values.get("success")
        reward, is_over = values.get("reward"), values.get("is_over")
        if not isinstance(reward, float) or success not in (True, False, None) or not isinstance(is_over, bool):
            raise BadMessage(
                f"The simulator sent reward {reward!r:.40}, success {success!r:.40}, is_over {is_over!r:.40}."
            )
        sizes = {part.name: part.size for part in self.offer.state}
        if {name: len(part) for name, part in seen.state.items()} != sizes:
            raise InvalidInput(f"The simulator sent the state {sorted(seen.state)}; announced are {sizes}.")
        shapes = {image.name: (image.height, image.width, 3) for image in self.offer.images}
        if {name: seen.image(name).shape for name in seen.images} != shapes:
            raise InvalidInput(f"The simulator sent images {sorted(seen.images)}; announced are {shapes}.")
        return Moment(seen, reward, success, is_over)

    def __enter__(self) -> SimulatorClient:
        """Return the client, which is closed at the end of the block."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()
