"""A policy that answers by chance: for tests, and to measure the way there and back."""

from __future__ import annotations

import numpy as np

from vlagents.chunk import Chunk
from vlagents.errors import InvalidInput
from vlagents.metadata import Metadata, PartSpec
from vlagents.observation import Observation
from vlagents.policy import Policy


class RandomPolicy(Policy):
    """Answers every observation with uniform numbers from -1 to 1; each session has a generator of its own."""

    def __init__(self, *, size: int = 7, horizon: int = 1, rate: float = 10.0, name: str = "joints") -> None:
        """Set the shape of chunks.

        Args:
            size: Numbers of an action.
            horizon: Rows of a chunk.
            rate: Rows per second [Hz].
            name: Of the action's only part.
        """
        self._metadata = Metadata(
            name="random", action=(PartSpec(name, size, meaning="delta"),), horizon=horizon, rate=rate
        )
        if rate <= 0:
            raise InvalidInput(f"rate is {rate!r}; valid is a number of hertz above 0.")
        self._shape = (horizon, size)
        self._generators: dict[str, np.random.Generator] = {}

    def metadata(self) -> Metadata:
        """Return the shape of chunks."""
        return self._metadata

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        """Begin a session's numbers anew."""
        self._generators[session] = np.random.default_rng(seed)

    def infer(self, observation: Observation) -> Chunk:
        """Return numbers by chance."""
        generator = self._generators.get(observation.session)
        if generator is None:
            generator = self._generators[observation.session] = np.random.default_rng()
        return Chunk(generator.uniform(-1.0, 1.0, self._shape), 1.0 / self._metadata.rate, observation.time)

    def forget(self, session: str) -> None:
        """Let go of a session's generator."""
        self._generators.pop(session, None)
