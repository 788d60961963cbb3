"""An agent that plays recorded actions, regardless of observations."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcs.agents.agent import Agent
from rcs.envs.spaces import Action, Observation
from rcs.errors import WrongOrder


class Replay(Agent):
    """Returns the actions of a recorded episode one after the other, regardless of observations."""

    def __init__(self, actions: Mapping[str, Any]) -> None:
        """Take the actions.

        Args:
            actions: One array (steps, ...) per key; with several robots, such a dictionary per robot.
        """
        self._actions = dict(actions)
        self._next = 0

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Start at the first action."""
        self._next = 0

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the next recorded action.

        Raises:
            WrongOrder: All actions were played.
        """
        try:
            action = _row(self._actions, self._next)
        except IndexError as err:
            raise WrongOrder(f"All {self._next} recorded actions were played; call reset to start again.") from err
        self._next += 1
        return action


def _row(actions: Mapping[str, Any], i: int) -> Action:
    return {key: _row(value, i) if isinstance(value, Mapping) else value[i] for key, value in actions.items()}
