"""A policy that draws its actions at random: for tests, and to measure the time of a call."""

from __future__ import annotations

import numpy as np

from vlagents.chunk import Chunk
from vlagents.errors import InvalidInput
from vlagents.metadata import Metadata, PartSpec
from vlagents.observation import Observation
from vlagents.policies.sessions import SessionPolicy


class RandomPolicy(SessionPolicy[np.random.Generator]):
    """Answers every observation with uniform numbers from -1 to 1; each session has a generator of its own."""

    def __init__(self, *, size: int = 7, horizon: int = 1, rate: float = 10.0, name: str = "joints") -> None:
        """Set the shape of chunks.

        Args:
            size: Numbers of an action.
            horizon: Rows of a chunk.
            rate: Rows per second [Hz].
            name: Name of the action's only part.

        Raises:
            InvalidInput: One of them is out of range.
        """
        action = (PartSpec(name, size, meaning="delta"),)
        super().__init__(Metadata(name="random", action=action, horizon=horizon, rate=rate))
        if rate <= 0:
            raise InvalidInput(f"rate is {rate!r}; valid is a number of hertz above 0.")

    def infer(self, observation: Observation) -> Chunk:
        """Return random numbers."""
        generator = self._session(observation).memory
        shape = (self._metadata.horizon, self._metadata.size)
        return Chunk(generator.uniform(-1.0, 1.0, shape), 1.0 / self._metadata.rate, observation.time)

    def _begin(self, seed: int | None) -> np.random.Generator:
        return np.random.default_rng(seed)
