"""Episodes in a batch are those of a single environment, bit for bit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents import Agent
from rcs.errors import InvalidSetup
from rcs.rollout.batch import run_batch
from rcs.rollout.collection import seed_of
from rcs.rollout.episode import EpisodeResult, run_episode

SETUP = rcs.Setup(task="PickCuboid", control="xyzrpy", max_episode_steps=34, observe=("privileged",))


class Approach(Agent):
    """Brings a finger of the open gripper down on the cuboid, which ends in a fault, or at the limit of steps."""

    def reset(self, observation: Any, info: Any) -> None:
        """Nothing to forget."""

    def act(self, observation: Any, info: Any) -> Any:
        way = observation["privileged"]["cuboid"]["tquat"][..., :3] - observation["tquat"][..., :3] + [0.0, 0.04, 0.0]
        turn = np.zeros_like(way)
        step = np.clip(np.concatenate([way, turn], -1), -0.016, 0.016)
        return {"xyzrpy": step, "gripper": np.ones((*way.shape[:-1], 1), np.float32)}


def alone(numbers: range, setup: rcs.Setup = SETUP) -> list[EpisodeResult]:
    with rcs.make(setup) as env:
        return [run_episode(env, Approach(), seed=seed_of(4, number)) for number in numbers]


@pytest.mark.parametrize(("copies", "threads", "reacts"), [(1, 1, True), (3, 2, True), (8, 1, False)])
def test_each_episode_is_as_it_is_alone(copies: int, threads: int, reacts: bool) -> None:
    setup = replace(SETUP, collision_reaction=reacts)
    envs = rcs.make_vec(setup, copies=copies, threads=threads, autoreset="Disabled")
    attempts = list(run_batch(envs, Approach(), range(7), lambda number: seed_of(4, number)))
    envs.close()
    assert sorted(attempt.number for attempt in attempts) == list(range(7))
    made = [attempt.result for attempt in sorted(attempts, key=lambda attempt: attempt.number)]
    assert made == alone(range(7), setup)
    assert {result.failure for result in made} == {"timeout", "fault" if reacts else "collision"}


def test_copies_that_start_by_themselves_are_refused() -> None:
    envs = rcs.make_vec(SETUP, copies=2)
    with pytest.raises(InvalidSetup, match="autoreset='Disabled'"):
        next(run_batch(envs, Approach(), range(2), lambda number: number))
    envs.close()


def test_where_nobody_judges_there_is_no_verdict() -> None:
    envs = rcs.make_vec("Free", copies=2, max_episode_steps=2, autoreset="Disabled")

    class Rest(Approach):
        def act(self, observation: Any, info: Any) -> Any:
            return {key: np.zeros(space.shape, space.dtype) for key, space in envs.action_space.items()}

    attempts = list(run_batch(envs, Rest(), range(3), lambda number: number))
    envs.close()
    assert [(one.result.success, one.result.failure, one.result.steps) for one in attempts] == [(None, None, 2)] * 3
