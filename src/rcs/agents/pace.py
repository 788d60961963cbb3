"""An agent at its own rate in an environment with a higher one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rcs.agents.agent import Agent
from rcs.envs.env import Env
from rcs.envs.spaces import TWIST, Action, Observation
from rcs.errors import InvalidSetup


class Pace:
    """Asks an agent for actions at its own rate, and repeats the last one in between."""

    def __init__(self, env: Env, agent: Agent) -> None:
        """Compare the rates.

        Args:
            env: The environment.
            agent: The agent.

        Raises:
            InvalidSetup: The agent's rate does not divide the environment's, or its repeated actions would add up.
        """
        self.agent = agent
        """The agent."""
        self.has_decided = False
        """Whether the last action was a decision, not a repetition."""
        self._env, self._every, self._steps = env, _steps_per_decision(env, agent), 0
        self._action: Action = {}

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Have the agent begin with an observation, also in mid-episode; it decides next."""
        self._steps = 0
        # The info of a step, unlike that of a reset, has no instruction.
        self.agent.reset(observation, {"instruction": self._env.instruction, **info})

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the agent's action for the next step."""
        self.has_decided = self._steps % self._every == 0
        self._steps += 1
        if self.has_decided:
            self._action = self.agent.act(observation, info)
        return self._action

    def notes(self) -> Mapping[str, Any]:
        """Return the agent's notes if it has decided; none for a repetition."""
        return self.agent.notes() if self.has_decided else {}


def _steps_per_decision(env: Env, agent: Agent) -> int:
    if agent.rate is None:
        return 1
    every = round(env.frequency / agent.rate)
    if every < 1 or abs(env.frequency - every * agent.rate) > 1e-6 * env.frequency:
        raise InvalidSetup(
            f"{type(agent).__name__} decides at {agent.rate:g} Hz and the environment steps at {env.frequency:g} Hz; "
            "its frequency must be a multiple of the agent's rate."
        )
    if every > 1 and env.setup.relative == "last_step" and env.setup.control != TWIST:
        raise InvalidSetup(
            f"{type(agent).__name__} decides at {agent.rate:g} Hz; in between its actions are repeated, and those "
            "relative to the last step would add up. Use relative='absolute' or 'origin'."
        )
    return every
