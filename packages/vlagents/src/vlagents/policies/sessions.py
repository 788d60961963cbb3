"""What a policy remembers of each session, apart from all others'."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from vlagents.errors import InvalidInput
from vlagents.observation import Observation

T = TypeVar("T")


@dataclass
class Session(Generic[T]):
    """One robot's, or one copy's."""

    instruction: str
    """What it was told at the reset."""
    memory: T
    """Whatever the policy keeps."""


class Sessions(Generic[T]):
    """Sessions by name. One that was never reset begins with its first observation."""

    def __init__(self, begin: Callable[[int | None], T]) -> None:
        """Set what a session begins with, as a function of the seed."""
        self._begin = begin
        self._sessions: dict[str, Session[T]] = {}

    def reset(self, name: str, instruction: str = "", seed: int | None = None) -> None:
        """Begin a session anew."""
        self._sessions[name] = Session(instruction, self._begin(seed))

    def of(self, observation: Observation) -> Session[T]:
        """Return the session of an observation."""
        if observation.session not in self._sessions:
            self.reset(observation.session)
        return self._sessions[observation.session]

    def forget(self, name: str) -> None:
        """Let go of a session."""
        self._sessions.pop(name, None)


def told(observation: Observation, session: Session[T], policy: str) -> str:
    """Return what is to be done: the observation's instruction, or that of the reset.

    Raises:
        InvalidInput: There is none.
    """
    instruction = observation.instruction or session.instruction
    if not instruction:
        raise InvalidInput(
            f"{policy} is told in words what to do, and there is no instruction. Give it to `reset`, or with the "
            "observation."
        )
    return instruction
