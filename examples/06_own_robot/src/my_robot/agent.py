"""An agent of our own: `rcs eval PushToLine --robot my_robot --agent Wander`. A policy goes in the same place."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rcs.agents.agent import Action, Agent
from rcs.envs.env import Env
from rcs.envs.spaces import Observation


class Wander(Agent):
    """Does something random, which shows how often chance succeeds."""

    def __init__(self, env: Env) -> None:
        """Act in an environment."""
        self._space = env.action_space

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Do the same in every episode that starts alike: the seed comes from what is observed."""
        self._space.seed(int.from_bytes(np.ascontiguousarray(observation["joints"])[:1].tobytes()[:4], "little"))

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return any valid action."""
        return self._space.sample()
