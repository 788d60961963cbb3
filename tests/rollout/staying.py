"""An agent that stays, and its evaluations."""

from __future__ import annotations

from typing import Any

import rcs
from rcs.agents import Agent
from rcs.rollout.evaluate import evaluate
from rcs.rollout.evaluation import Evaluation, Summary

SETUP = rcs.Setup(task="PickCuboid", max_episode_steps=4)
"""Episodes that end before anything is picked."""


class Stay(Agent):
    """Keeps every joint and every gripper where it is."""

    def __init__(self, env: Any) -> None:
        self._action = env.action_space.sample()
        self._action["joints"][:] = 0.0
        self._action["gripper"][:] = 1.0

    def reset(self, observation: Any, info: Any) -> None:
        """Nothing to forget."""

    def act(self, observation: Any, info: Any) -> Any:
        return self._action


def run(**options: Any) -> Summary:
    summary = Summary()
    for _ in evaluate(Evaluation(**{"setup": SETUP, "agent": Stay, "episodes": 3, **options}), summary):
        pass
    return summary
