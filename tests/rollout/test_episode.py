from __future__ import annotations

from typing import Any

import pytest

import rcs
from rcs.agents import Agent
from rcs.rollout.episode import run_episode


class Wait(Agent):
    """Stays where it is, and has something go wrong in its third step."""

    def __init__(self, env: Any, *, has_fault: bool = False) -> None:
        self._env = env
        self._has_fault = has_fault
        self._steps = 0

    def reset(self, observation: Any, info: Any) -> None:
        self._steps = 0

    def act(self, observation: Any, info: Any) -> Any:
        self._steps += 1
        if self._has_fault and self._steps == 3:
            self._env.stack.faults = lambda: {"arm": "touched something"}
        action = self._env.action_space.sample()
        action["joints"][:] = 0.0
        return action


def test_where_no_task_judges_success_is_not_known() -> None:
    env = rcs.make("Free", max_episode_steps=5)
    result = run_episode(env, Wait(env), seed=0)
    assert (result.success, result.failure, result.steps) == (None, None, 5)


def test_a_task_that_is_not_done_in_time_has_failed() -> None:
    env = rcs.make("PickCuboid", max_episode_steps=5)
    result = run_episode(env, Wait(env), seed=0)
    assert (result.success, result.failure, result.steps) == (False, "timeout", 5)


@pytest.mark.parametrize("task", ["PickCuboid", "Free"])
def test_an_episode_that_a_fault_ends_is_not_judged(task: str) -> None:
    env = rcs.make(task)
    result = run_episode(env, Wait(env, has_fault=True), seed=0)
    assert (result.success, result.failure, result.steps) == (None, "fault", 3)
