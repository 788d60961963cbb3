"""A policy that answers again what another one has answered."""

from __future__ import annotations

from pathlib import Path

from vlagents.around.recorded import read_calls
from vlagents.chunk import Chunk
from vlagents.errors import InvalidInput
from vlagents.metadata import Metadata
from vlagents.observation import Observation
from vlagents.policy import Policy
from vlagents.wire.calls import chunk_from_values


class ReplayPolicy(Policy):
    """Answers the n-th observation of a session with the n-th chunk of a record, whatever is observed."""

    def __init__(self, checkpoint: str | Path) -> None:
        """Read a file that `Recorded` wrote.

        Raises:
            InvalidInput: It is none, or nothing was answered in it.
        """
        metadata: Metadata | None = None
        self._chunks: list[Chunk] = []
        for call in read_calls(checkpoint):
            if "metadata" in call:
                metadata = Metadata.from_dict(call["metadata"])
            if "chunk" in call:
                self._chunks.append(chunk_from_values(call["chunk"]))
        if metadata is None or not self._chunks:
            raise InvalidInput(f"{checkpoint} has no answers to replay.")
        self._metadata = metadata
        self._next: dict[str, int] = {}

    def metadata(self) -> Metadata:
        """Return what the policy that was recorded needs and gives."""
        return self._metadata

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        """Begin with the first answer again."""
        self._next[session] = 0

    def infer(self, observation: Observation) -> Chunk:
        """Return the next answer, for the time of this observation.

        Raises:
            InvalidInput: There is none left.
        """
        index = self._next.get(observation.session, 0)
        if index >= len(self._chunks):
            raise InvalidInput(f"All {len(self._chunks)} answers were replayed; reset begins anew.")
        self._next[observation.session] = index + 1
        chunk = self._chunks[index]
        return Chunk(chunk.actions, chunk.period, observation.time, chunk.info)

    def forget(self, session: str) -> None:
        """Let go of a session's place."""
        self._next.pop(session, None)
