"""The interface of an agent: twelve lines that a script, a planner, a person at a device and a policy share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from rcs.envs.spaces import Observation

Action = dict[str, Any]
"""An array per key, or, with several robots, such a dictionary per robot."""


class Agent(ABC):
    """Maps an observation to an action."""

    @abstractmethod
    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Begin an episode with its first observation."""

    @abstractmethod
    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the next action."""

    @property
    def failure(self) -> str | None:
        """Why the agent gave up, as a class such as `ik` or `no_contact`; None while it has not."""
        return None
