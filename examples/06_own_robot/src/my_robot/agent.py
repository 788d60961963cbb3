"""An agent: `rcs eval PushToLine --robot my_robot --agent Wander`. Use a policy in the same way."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rcs.agents import Agent
from rcs.envs import Action, Env, Observation


class Wander(Agent):
    """Acts at random, as a baseline."""

    def __init__(self, env: Env) -> None:
        """Create an agent for an environment."""
        self._space = env.action_space

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Seed from the observation, so that equal starts lead to equal episodes."""
        self._space.seed(int.from_bytes(np.ascontiguousarray(observation["joints"])[:1].tobytes()[:4], "little"))

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return any valid action."""
        return self._space.sample()
