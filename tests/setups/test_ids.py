from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import rcs

IDS = ["rcs/PickCuboid-FR3-v0", "rcs/FR3-v0"]


@pytest.mark.parametrize("name", IDS)
def test_gymnasium_makes_every_id(name: str) -> None:
    env = gymnasium.make(name, control="tquat")
    observation, _ = env.reset(seed=1)
    expected, _ = rcs.make("PickCuboid" if "Pick" in name else "Free", control="tquat").reset(seed=1)
    for key in expected:
        np.testing.assert_array_equal(observation[key], expected[key])
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
    observation, _ = envs.reset(seed=0)
    assert observation["joints"].shape == (3, 7)
    envs.step(envs.action_space.sample())
    envs.close()


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
