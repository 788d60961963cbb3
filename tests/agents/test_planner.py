"""The agent that plans."""

from __future__ import annotations

import numpy as np
import pytest

import rcs
from rcs.agents import PickExpert, PickPlanner
from rcs.errors import InvalidSetup
from rcs.planning import diversity

pytestmark = pytest.mark.extras


def way(env: rcs.envs.Env, agent: rcs.agents.Agent, seed: int, steps: int = 60) -> np.ndarray:
    observation, info = env.reset(seed=seed)
    agent.reset(observation, info)
    rows = [observation["joints"]]
    for _ in range(steps):
        observation, _, ended, cut, info = env.step(agent.act(observation, info))
        rows.append(observation["joints"])
        if ended or cut:
            break
    return np.array(rows)


@pytest.mark.parametrize("relative", ["last_step", "absolute"])
def test_it_picks_between_posts_where_the_script_runs_into_them(relative: str) -> None:
    options = {"relative": relative, "control": "joints", "task_options": {"obstacles": 4}}
    with rcs.make("PickCuboid", robot="fr3", **options) as env:
        planner, script = PickPlanner(env), PickExpert(env)
        seeds = (3, 4, 5)  # of episodes in which the script fails
        assert all(rcs.run_episode(env, planner, seed=seed).success for seed in seeds)
        assert not all(rcs.run_episode(env, script, seed=seed).success for seed in seeds)


def test_the_same_episode_has_the_same_way_and_others_differ_more_than_the_scripts() -> None:
    with rcs.make("PickCuboid", robot="fr3", task_options={"obstacles": 2}) as env:
        agent = PickPlanner(env)
        np.testing.assert_array_equal(way(env, agent, 1), way(env, PickPlanner(env), 1))
        planned, scripted = ([way(env, one, seed) for seed in range(5)] for one in (agent, PickExpert(env)))
        assert diversity(planned) > 1.5 * diversity(scripted)


def test_it_is_for_one_robot() -> None:
    with rcs.make("LiftBar", robot="dual_fr3") as env, pytest.raises(InvalidSetup, match="one robot"):
        PickPlanner(env)
