"""Lift-Bar: two arms in one scene, one physics step, keys under the robots' names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset

import rcs
from rcs.agents import agent_for
from rcs.errors import InvalidAction, InvalidSetup
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.rollout.episode import run_episode
from rcs.rollout.replay import replay
from rcs.testing.env_contract import require_same_bits

SETUP = rcs.Setup(task="LiftBar", robot="dual_fr3")


def still(env: Any) -> dict[str, Any]:
    action = {name: dict(space.sample()) for name, space in env.action_space.spaces.items()}
    for part in action.values():
        part["joints"][:] = 0.0
        part["gripper"][:] = 1.0
    return action


def test_keys_are_under_the_robots_names_and_frames_stay_at_the_top() -> None:
    env = rcs.make(rcs.Setup(task="LiftBar", robot="dual_fr3", cameras=("front", "left_wrist")))
    assert set(env.observation_space.spaces) == {"left", "right", "frames"}
    assert set(env.action_space.spaces) == {"left", "right"}
    assert set(env.observation_space["frames"].spaces) == {"front", "left_wrist"}


def test_a_step_of_one_arm_leaves_the_other_where_it_is() -> None:
    env = rcs.make(SETUP)
    before, _ = env.reset(seed=0)
    action = still(env)
    action["left"]["joints"][0] = 0.05
    for _ in range(20):
        after, *_ = env.step(action)
    assert after["left"]["joints"][0] > 0.5
    np.testing.assert_allclose(after["right"]["joints"], before["right"]["joints"], atol=1e-3)


def test_a_bad_action_of_one_arm_moves_neither() -> None:
    env = rcs.make(SETUP)
    env.reset(seed=0)
    before = env.simulation.world.states().copy()
    action = still(env)
    action["left"]["joints"][0] = 0.05
    action["right"]["joints"][3] = np.nan
    with pytest.raises(InvalidAction, match=r"Robot 'right'.*joints"):
        env.step(action)
    np.testing.assert_array_equal(env.simulation.world.states(), before)
    with pytest.raises(InvalidAction, match=r"one action per robot.*left.*right"):
        env.step({"left": action["left"]})


def test_a_copy_of_a_batch_is_the_single_environment_bit_for_bit() -> None:
    single, batch = rcs.make(SETUP), rcs.make_vec(SETUP, copies=3)
    one, _ = single.reset(seed=12)
    many, _ = batch.reset(seed=10)
    require_same_bits(one, {name: {key: value[2] for key, value in part.items()} for name, part in many.items()})
    actions = batch.action_space.sample()
    for _ in range(5):
        many, *_ = batch.step(actions)
        own = {name: {key: value[2] for key, value in part.items()} for name, part in actions.items()}
        one, *_ = single.step(own)
    require_same_bits(one, {name: {key: value[2] for key, value in part.items()} for name, part in many.items()})


@pytest.mark.parametrize("control", ["joints", "xyzrpy"])
def test_the_expert_lifts_the_bar_with_both_arms(control: Any) -> None:
    setup = rcs.Setup(task="LiftBar", robot="dual_fr3", control=control)
    env = rcs.make(setup)
    expert = agent_for(env)
    results = [run_episode(env, expert, seed=seed) for seed in range(3)]
    assert all(result.success for result in results)


def test_a_bar_out_of_reach_is_an_ik_failure() -> None:
    env = rcs.make(SETUP)
    expert = agent_for(env)
    observation, info = env.reset(seed=0)
    far = info["bar_in_scene"].copy()
    far[0] = 2.0
    expert.reset(observation, {**info, "bar_in_scene": far})
    assert expert.failure == "ik"
    env.step(expert.act(observation, info))


def test_a_recorded_episode_of_two_arms_replays_bit_for_bit(tmp_path: Path) -> None:
    collection = Collection(setup=SETUP, out=tmp_path / "dual", episodes=1, seed=3)
    for _ in collect(collection, Progress()):
        pass
    columns = {feature.key for feature in Dataset.open(tmp_path / "dual").info.features}
    assert {"observation/left/joints", "action/right/gripper", "executed/left/joints"} <= columns
    assert all(result.is_equal for result in replay(tmp_path / "dual"))


def test_one_arm_can_not_be_asked_to_lift_the_bar() -> None:
    with pytest.raises(InvalidSetup, match="2 robots"):
        rcs.make("LiftBar", robot="fr3")


def test_two_arms_can_not_be_asked_to_pick_the_cuboid() -> None:
    with pytest.raises(InvalidSetup, match="one robot"):
        rcs.make("PickCuboid", robot="dual_fr3")
