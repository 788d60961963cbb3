"""The part that policies share: a memory of each session, apart from all others'."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from vlagents.chunk import Chunk
from vlagents.errors import InvalidInput
from vlagents.metadata import Metadata
from vlagents.observation import Observation
from vlagents.policy import Policy

T = TypeVar("T")


@dataclass
class Session(Generic[T]):
    """The session of one robot, or of one copy."""

    instruction: str
    """The instruction of the reset."""
    memory: T
    """Whatever the policy remembers."""


class SessionPolicy(Policy, Generic[T]):
    """A policy with fixed metadata and a memory of each session, which begins with a reset or the first observation."""

    def __init__(self, metadata: Metadata) -> None:
        """Set the metadata."""
        self._metadata = metadata
        self._sessions: dict[str, Session[T]] = {}

    def metadata(self) -> Metadata:
        """Return what the policy needs and gives."""
        return self._metadata

    def reset(self, session: str = "", instruction: str = "", *, seed: int | None = None) -> None:
        """Begin an episode: forget the session's memory, and keep the instruction."""
        self._sessions[session] = Session(instruction, self._begin(seed))

    def forget(self, session: str) -> None:
        """Forget a session."""
        self._sessions.pop(session, None)

    def _warm_up(self) -> Chunk:
        """Call the policy once, so that its model is compiled before a robot waits for it; return the answer."""
        black = {image.name: np.zeros((image.height, image.width, 3), np.uint8) for image in self._metadata.images}
        state = {part.name: np.zeros(part.size) for part in self._metadata.state}
        goals = black if self._metadata.needs_goal else {}
        chunk = self.infer(Observation(black, state, "wait", goals, session="warm-up"))
        self.forget("warm-up")
        return chunk

    def _begin(self, seed: int | None) -> Any:
        """Return the memory of a new session."""

    def _session(self, observation: Observation) -> Session[T]:
        if observation.session not in self._sessions:
            self._sessions[observation.session] = Session("", self._begin(None))
        return self._sessions[observation.session]

    def _instruction(self, observation: Observation) -> str:
        """Return the observation's instruction, or that of the reset.

        Raises:
            InvalidInput: There is none.
        """
        instruction = observation.instruction or self._session(observation).instruction
        if not instruction:
            raise InvalidInput(
                f"{self._metadata.name} needs an instruction in words. Give it to `reset`, or with the observation."
            )
        return instruction
