"""The teacher remembers nothing, and puts the cuboid on its mark from wherever the arm was brought."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents import PlaceTeacher
from rcs.envs.setup import Setup
from rcs.envs.vector import VecEnv
from rcs.errors import InvalidSetup

SETUP = Setup(
    task="Place",
    frequency=10.0,
    max_episode_steps=120,
    observe=("privileged", "contacts"),
    layers=("ObserveTarget",),
    collision_reaction=False,
)


def row(observation: Any, copy: int) -> Any:
    if isinstance(observation, dict):
        return {key: row(value, copy) for key, value in observation.items()}
    return observation[copy]


def succeed(envs: VecEnv, teacher: PlaceTeacher, observation: Any, steps: int) -> np.ndarray:
    done = np.zeros(envs.num_envs, bool)
    for _ in range(steps):
        observation, _, terminated, truncated, _ = envs.step(teacher.act(observation, {}))
        done |= terminated
        if (is_over := terminated | truncated).any():
            observation, _ = envs.reset(options={"reset_mask": is_over})
        if done.all():
            break
    return done


def test_it_sets_the_cuboid_down_in_every_copy() -> None:
    envs = rcs.make_vec(SETUP, copies=8, autoreset="Disabled")
    observation, _ = envs.reset(seed=0)
    assert succeed(envs, PlaceTeacher(envs), observation, 70).all()


def test_it_sets_the_cuboid_down_after_somebody_else_acted() -> None:
    envs = rcs.make_vec(SETUP, copies=8, autoreset="Disabled")
    teacher, rng = PlaceTeacher(envs), np.random.default_rng(0)
    observation, _ = envs.reset(seed=20)
    space: Any = envs.single_action_space
    bound = space["joints"].high
    for step in range(22):  # to the cuboid and up, dropped now and then, but not onto the mark
        action = teacher.act(observation, {})
        action["joints"] = np.clip(action["joints"] + rng.normal(0.0, 0.01, (8, 7)), -bound, bound)
        action["gripper"] = np.where(step % 5 == 4, 1.0 - action["gripper"], action["gripper"])
        observation, _, _, truncated, _ = envs.step(action)
        assert not truncated.any()
    assert succeed(envs, teacher, observation, 90).sum() >= 7  # one may have been thrown off the table


def test_an_action_follows_from_the_observation_alone_and_is_that_of_one_copy() -> None:
    envs, env = rcs.make_vec(SETUP, copies=4, autoreset="Disabled"), rcs.make(SETUP)
    teacher, alone = PlaceTeacher(envs), PlaceTeacher(env)
    observation, _ = envs.reset(seed=3)
    for _ in range(30):
        action = teacher.act(observation, {})
        for copy in range(4):
            for key, value in alone.act(row(observation, copy), {}).items():
                np.testing.assert_array_equal(value, action[key][copy])
        observation, *_ = envs.step(action)


def test_another_task_is_refused() -> None:
    env = rcs.make("PickCuboid", observe=("privileged", "contacts"), layers=("ObserveTarget",))
    with pytest.raises(InvalidSetup, match="PlaceTeacher is for Place"):
        PlaceTeacher(env)
