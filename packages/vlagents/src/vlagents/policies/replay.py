"""A file of the calls of a policy and its answers: `Recorded` writes it, `ReplayPolicy` answers from it."""

from __future__ import annotations

import os
import struct
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from vlagents.around import Around
from vlagents.chunk import Chunk
from vlagents.errors import InvalidInput
from vlagents.metadata import Metadata
from vlagents.observation import Observation
from vlagents.policies.sessions import SessionPolicy
from vlagents.policy import Policy
from vlagents.wire.calls import chunk_from_values, chunk_to_values, observation_to_values
from vlagents.wire.message import pack, unpack

MAGIC = b"VLAR1\n"
LENGTHS = struct.Struct("<IQ")


class Recorded(Around):
    """Keeps every call of the policy inside. The calls that are in the file when the process is killed can be read."""

    def __init__(self, inside: Policy, path: str | Path, *, with_images: bool = False) -> None:
        """Begin a file.

        Args:
            inside: The policy.
            path: A new file.
            with_images: Whether pictures are kept, too; a hundred times the size.

        Raises:
            FileExistsError: There is such a file.
        """
        super().__init__(inside)
        self._with_images = with_images
        self._lock = threading.Lock()
        self._file = open(path, "xb")  # noqa: SIM115  it is open for as long as the policy
        self._file.write(MAGIC)
        self._write({"metadata": inside.metadata().to_dict()})

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        """Begin an episode inside, and keep that."""
        super().reset(session, instruction, seed=seed)
        self._write({"reset": {"session": session, "instruction": instruction, "seed": seed}})

    def infer(self, observation: Observation) -> Chunk:
        """Ask the policy inside, and keep question and answer."""
        chunk = super().infer(observation)
        values = observation_to_values(observation)
        if not self._with_images:
            values = {**values, "images": {}, "goals": {}}
        self._write({"observation": values, "chunk": chunk_to_values(chunk)})
        return chunk

    def close(self) -> None:
        """Close the file and the policy."""
        with self._lock:
            if not self._file.closed:
                self._file.flush()
                os.fsync(self._file.fileno())
                self._file.close()
        super().close()

    def _write(self, values: Any) -> None:
        header, parts, size = pack(values)
        with self._lock:
            self._file.write(LENGTHS.pack(len(header), size) + header)
            self._file.writelines(parts)
            self._file.flush()


def read_calls(path: str | Path) -> Iterator[dict[str, Any]]:
    """Yield what a `Recorded` kept; a last call that was cut off by a kill is left out.

    Raises:
        InvalidInput: The file is none of these.
    """
    with open(path, "rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise InvalidInput(f"{path} is no record of a policy's calls.")
        left = os.path.getsize(path) - len(MAGIC)
        while left >= LENGTHS.size:
            header_size, size = LENGTHS.unpack(file.read(LENGTHS.size))
            left -= LENGTHS.size + header_size + size
            if left < 0:
                return
            yield unpack(file.read(header_size), file.read(size))


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
