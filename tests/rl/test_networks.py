from __future__ import annotations

import numpy as np
import pytest

import rcs
from rcs.rl import Flat, Ppo, Sb3VecEnv, Training
from rcs.rl.learner import make_model
from rcs.rl.networks import make_policy, network_options

pytestmark = pytest.mark.extras

SETUP = rcs.Setup(observe=("privileged",), collision_reaction=False, reward="dense", max_episode_steps=4)


def test_a_network_is_told_every_number_coarsely_and_finely() -> None:
    torch = pytest.importorskip("torch")
    flat = Flat(rcs.make(SETUP))
    policy = make_policy(Ppo(near_and_far=True, network=(8,)), flat)
    numbers = torch.tensor([[0.001, -0.2, 5.0]])
    told = policy.features_extractor(numbers).numpy()[0]
    np.testing.assert_allclose(told[:3], 2 * np.tanh([0.0005, -0.1, 2.5]), rtol=1e-6)
    np.testing.assert_allclose(told[3:], np.tanh([0.004, -0.8, 20.0]), rtol=1e-6)


def test_a_network_sees_pictures_without_that() -> None:
    algorithm = Ppo(near_and_far=True)
    assert "features_extractor_class" in network_options(algorithm, has_images=False)
    assert "features_extractor_class" not in network_options(algorithm, has_images=True)
    assert "features_extractor_class" not in network_options(Ppo(near_and_far=False), has_images=False)


def test_the_first_values_are_near_zero() -> None:
    torch = pytest.importorskip("torch")
    envs = Sb3VecEnv(rcs.make_vec(SETUP, copies=2, autoreset="SameStep"))
    algorithm = Ppo(n_steps=4, batch_size=8)
    policy = make_model(Training(setup=SETUP, copies=2, steps=8, algorithm=algorithm), algorithm, envs).policy
    assert float(policy.predict_values(torch.tensor(envs.reset())).detach().abs().max()) < 0.1
    envs.close()
