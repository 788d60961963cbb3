from __future__ import annotations

import numpy as np

import rcs


def test_nothing_is_won_and_nothing_ends() -> None:
    env = rcs.make("Free")
    observation, info = env.reset(seed=0)
    again, _ = env.reset(seed=1)
    np.testing.assert_array_equal(observation["joints"], again["joints"])
    assert info == {"time": 0.0, "instruction": ""}
    _, reward, terminated, truncated, info = env.step(env.action_space.sample())
    assert (reward, terminated, truncated) == (0.0, False, False)
    assert "success" not in info


def test_copies_have_an_outcome_each() -> None:
    envs = rcs.make_vec("Free", copies=3)
    envs.reset(seed=0)
    _, reward, terminated, _, _ = envs.step(envs.action_space.sample())
    for value in (reward, terminated):
        np.testing.assert_array_equal(value, np.zeros(3))
