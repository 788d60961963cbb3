from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.rl import Flat, Ppo, Sb3VecEnv, Training
from rcs.rl.learner import make_model
from rcs.rl.networks import make_policy

pytestmark = pytest.mark.extras

SETUP = rcs.Setup(observe=("privileged",), collision_reaction=False, reward="dense", max_episode_steps=4)


def copies(**options: Any) -> Sb3VecEnv:
    return Sb3VecEnv(rcs.make_vec(SETUP, copies=2, autoreset="SameStep"), **options)


def test_a_network_is_told_every_number_coarsely_and_finely() -> None:
    torch = pytest.importorskip("torch")
    flat = Flat(rcs.make(SETUP))
    policy = make_policy(Ppo(near_and_far=True, network=(8,)), flat)
    numbers = torch.tensor([[0.001, -0.2, 5.0]])
    told = policy.features_extractor(numbers).numpy()[0]
    np.testing.assert_allclose(told[:3], 2 * np.tanh([0.0005, -0.1, 2.5]), rtol=1e-6)
    np.testing.assert_allclose(told[3:], np.tanh([0.004, -0.8, 20.0]), rtol=1e-6)


def test_the_first_values_are_near_zero() -> None:
    torch = pytest.importorskip("torch")
    envs = copies()
    algorithm = Ppo(n_steps=4, batch_size=8)
    policy = make_model(Training(setup=SETUP, copies=2, steps=8, algorithm=algorithm), algorithm, envs).policy
    assert float(policy.predict_values(torch.tensor(envs.reset())).detach().abs().max()) < 0.1
    envs.close()


def test_rewards_are_scaled_for_the_learner_and_returns_are_told_as_they_are() -> None:
    one, half = copies(), copies(reward_scale=0.5)
    rewards: list[Any] = []
    for envs in (one, half):
        envs.seed(0)
        envs.reset()
        infos: list[Any] = []
        for _ in range(4):
            _, reward, _, infos = envs.step(np.zeros((2, *envs.action_space.shape), np.float32))
            rewards.append(reward)
        rewards.append([info["episode"]["r"] for info in infos])
        envs.close()
    np.testing.assert_allclose(np.array(rewards[:4]) * 0.5, rewards[5:9], rtol=1e-6)
    np.testing.assert_allclose(rewards[4], rewards[9])
