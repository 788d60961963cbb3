"""A policy made of one function, such as a controller or a test."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from vlagents.chunk import Chunk
from vlagents.errors import InvalidInput
from vlagents.metadata import Metadata
from vlagents.observation import Observation
from vlagents.policies.sessions import SessionPolicy


class ScriptedPolicy(SessionPolicy[None]):
    """Answers with a function's actions for an observation and the session's instruction."""

    def __init__(self, act: Callable[[Observation, str], Any], metadata: Metadata) -> None:
        """Set the function.

        Args:
            act: A function of an observation and the instruction that returns actions, (horizon, size) or (size,).
            metadata: Description of what the function needs and gives, with the rate of its rows.

        Raises:
            InvalidInput: The metadata have no rate.
        """
        if metadata.rate <= 0:
            raise InvalidInput(f"rate of {metadata.name!r} is {metadata.rate!r}; valid is a number of hertz above 0.")
        super().__init__(metadata)
        self._act = act

    def infer(self, observation: Observation) -> Chunk:
        """Return the function's actions."""
        instruction = observation.instruction or self._session(observation).instruction
        actions = np.atleast_2d(np.asarray(self._act(observation, instruction), np.float64))
        return Chunk(actions, 1.0 / self._metadata.rate, observation.time)
