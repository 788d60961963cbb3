from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.rl import Flat
from rcs.rl.recipes import RECIPES, recipe_for
from rcs.rl.training import Ppo

ROBOTS = {"fr3": None, "ur5e": None, "so101": None, "xarm7": "robotiq_2f85"}


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_recipe_moves_every_robot_by_translation_yaw_and_gripper(robot: str) -> None:
    env = rcs.make(replace(recipe_for("PickCuboid").setup, robot=robot, end_effector=ROBOTS[robot]))
    flat = Flat(env)
    observation, _ = env.reset(seed=0)
    assert flat.action_space.shape == (5,)
    assert np.abs(flat.observation(observation)).max() < 10.0  # nothing that a network could not take
    start = observation["tquat"][2]
    down = {"xyzyaw": np.array([0.0, 0.0, -0.02, 0.0]), "gripper": np.ones(1, np.float32)}
    for _ in range(3):
        observation = env.step(down)[0]
    assert observation["tquat"][2] < start - 1e-3
    assert observation["target"]["tquat"][2] < observation["tquat"][2] + 1e-3
    env.close()


@pytest.mark.parametrize(("task", "algorithm"), RECIPES)
def test_an_update_of_a_recipe_sees_whole_episodes(task: str, algorithm: Any) -> None:
    recipe = recipe_for(task, algorithm)
    assert recipe.setup.task == task
    if isinstance(recipe.algorithm, Ppo):
        assert recipe.algorithm.n_steps == recipe.setup.max_episode_steps
