from __future__ import annotations

import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import rcs
from rcs.errors import InvalidSetup
from rcs.setups.ids import ids
from rcs.testing.env_contract import require_same_bits

IDS = list(ids())


@pytest.mark.parametrize("name", IDS)
def test_gymnasium_makes_every_id(name: str) -> None:
    env = gymnasium.make(name, control="tquat")
    observation, _ = env.reset(seed=1)
    task, robot = ids()[name]
    expected, _ = rcs.make(task, robot=robot, control="tquat").reset(seed=1)
    require_same_bits(observation, expected)
    assert env.spec is not None
    env.close()


@pytest.mark.parametrize("name", IDS)
def test_gymnasiums_checker_passes_without_a_warning(name: str) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(gymnasium.make(name).unwrapped, skip_render_check=True)
    assert [str(warning.message) for warning in caught] == []


@pytest.mark.gl
def test_the_registered_environment_renders() -> None:
    env = gymnasium.make("rcs/FR3-v0", render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert isinstance(picture, np.ndarray)
    assert picture.shape == (480, 640, 3)
    env.close()


@pytest.mark.parametrize("name", IDS)
def test_gymnasium_makes_batches_with_the_native_threads(name: str) -> None:
    envs = gymnasium.make_vec(name, num_envs=3, vectorization_mode="vector_entry_point", control="joints")
    assert envs.num_envs == 3
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    observations, _ = envs.reset(seed=0)
    task, robot = ids()[name]
    single = rcs.make(task, robot=robot)
    require_same_bits(single.reset(seed=2)[0], copy_of(observations, 2))
    actions = envs.action_space.sample()
    observations, *_ = envs.step(actions)
    require_same_bits(single.step(copy_of(actions, 2))[0], copy_of(observations, 2))
    envs.close()


@pytest.mark.parametrize("steps", [3, 7])
def test_gymnasiums_limit_of_steps_is_that_of_the_episode(steps: int) -> None:
    name = "rcs/PickCuboid-FR3-v0"
    env = gymnasium.make(name, max_episode_steps=steps)
    envs = gymnasium.make_vec(name, 2, vectorization_mode="vector_entry_point", max_episode_steps=steps)
    for one in (env, envs, rcs.make("PickCuboid", max_episode_steps=steps)):
        one.reset(seed=0)
        action = one.action_space.sample()
        ends = [np.any(one.step(action)[3]) for _ in range(steps)]
        assert ends == [False] * (steps - 1) + [True]
        one.close()


def test_without_a_limit_gymnasiums_environments_have_the_setups() -> None:
    spec = gymnasium.spec("rcs/PickCuboid-FR3-v0")
    assert spec.max_episode_steps == rcs.Setup().max_episode_steps


def test_the_rate_of_pictures_is_that_of_steps() -> None:
    env = gymnasium.make("rcs/FR3-v0", frequency=20)
    envs = gymnasium.make_vec("rcs/FR3-v0", 1, vectorization_mode="vector_entry_point", frequency=20)
    assert env.metadata["render_fps"] == envs.metadata["render_fps"] == 20
    env.close()
    envs.close()


@pytest.mark.parametrize("mode", ["human", "rgb_array"])
def test_a_batch_that_should_draw_pictures_is_refused_with_what_to_do(mode: Any) -> None:
    for make in (
        lambda: rcs.make_vec("Free", render_mode=mode),
        lambda: gymnasium.make_vec("rcs/FR3-v0", 2, vectorization_mode="vector_entry_point", render_mode=mode),
    ):
        with pytest.raises(InvalidSetup, match=r"render_mode is .*cameras=.*rcs\.make"):
            make()


def copy_of(values: dict[str, Any], copy: int) -> dict[str, Any]:
    return {key: copy_of(value, copy) if isinstance(value, dict) else value[copy] for key, value in values.items()}


def test_ordinary_gymnasium_wrappers_go_on_top() -> None:
    env = gymnasium.wrappers.RecordEpisodeStatistics(gymnasium.wrappers.TimeLimit(gymnasium.make("rcs/FR3-v0"), 3))
    env.reset(seed=0)
    for _ in range(3):
        *_, truncated, info = env.step(env.action_space.sample())
    assert truncated
    assert info["episode"]["l"] == 3


@pytest.mark.extras
@pytest.mark.parametrize("name", IDS)
def test_stable_baselines3s_checker_passes(name: str) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="Stable-Baselines3 is not installed")
    # Its algorithms take no dictionaries as actions, which it warns of; a wrapper that flattens them goes on top.
    with pytest.warns(UserWarning, match="flatten the action"):
        checker.check_env(gymnasium.make(name).unwrapped, skip_render_check=True)
