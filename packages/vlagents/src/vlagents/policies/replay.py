"""A policy that repeats the recorded answers of another one."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from vlagents.chunk import Chunk
from vlagents.errors import InvalidInput
from vlagents.metadata import Metadata
from vlagents.observation import Observation
from vlagents.policies.sessions import SessionPolicy
from vlagents.recorded import read_calls
from vlagents.wire.calls import chunk_from_values


class ReplayPolicy(SessionPolicy[Iterator[Chunk]]):
    """Answers the n-th observation of a session with the n-th chunk of a record, whatever is observed."""

    def __init__(self, checkpoint: str | Path) -> None:
        """Read a file that `Recorded` wrote.

        Args:
            checkpoint: The file.

        Raises:
            InvalidInput: It is no such file, or has no answers.
        """
        calls = list(read_calls(checkpoint))
        self._chunks = [chunk_from_values(call["chunk"]) for call in calls if "chunk" in call]
        if not self._chunks or "metadata" not in calls[0]:
            raise InvalidInput(f"{checkpoint} has no answers to replay.")
        super().__init__(Metadata.from_dict(calls[0]["metadata"]))

    def infer(self, observation: Observation) -> Chunk:
        """Return the next answer, for the time of this observation.

        Raises:
            InvalidInput: There is none left.
        """
        chunk = next(self._session(observation).memory, None)
        if chunk is None:
            raise InvalidInput(f"All {len(self._chunks)} answers were replayed; reset begins again.")
        return Chunk(chunk.actions, chunk.period, observation.time, chunk.info)

    def _begin(self, seed: int | None) -> Iterator[Chunk]:
        return iter(self._chunks)
