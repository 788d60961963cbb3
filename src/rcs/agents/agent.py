"""The interface of an agent: a script, a planner, a person at a device, or a policy."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Literal

from rcs.envs.spaces import Action, Observation

Event = Literal["engage", "release", "start", "stop", "discard", "reset", "takeover"]
"""What an operator asks for besides an action."""


class Agent(ABC):
    """Maps an observation to an action. Agents for an environment are made by a factory: `PickExpert(env)`."""

    rate: float | None = None
    """How often the agent decides [Hz]; None for once per step of the environment."""

    @abstractmethod
    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Begin an episode with its first observation."""

    @abstractmethod
    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the next action."""

    def close(self) -> None:  # noqa: B027  most agents hold nothing
        """Release devices, threads and connections. Closing twice is harmless."""

    @property
    def failure(self) -> str | None:
        """Why the agent gave up, as a class such as `ik` or `no_contact`; None if it has not."""
        return None

    @property
    def failure_message(self) -> str | None:
        """What went wrong in this episode, for people to read; None where there is no more to say than the class."""
        return None

    def notes(self) -> Mapping[str, Any]:
        """Return notes to record with the last action: who acted, latency [s], place in a chunk."""
        return {}

    def events(self) -> Sequence[Event]:
        """Return an operator's requests since the last call, oldest first."""
        return ()
