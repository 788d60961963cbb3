from __future__ import annotations

from typing import Any

import numpy as np

import rcs
from rcs.envs.layers import ObserveTarget
from rcs.spatial import distance

OPTIONS: Any = {"control": "xyzrpy", "frequency": 10.0, "layers": [ObserveTarget]}


def test_the_target_is_where_the_tcp_is_sent_and_where_it_comes_to_rest() -> None:
    env = rcs.make("Free", **OPTIONS)
    first = env.reset(seed=0)[0]
    np.testing.assert_array_equal(first["target"]["tquat"], first["tquat"])
    move, opening = np.array([0.05, 0.0, -0.05, 0.0, 0.0, 0.0]), np.ones(1, np.float32)
    for steps in (1, 2, 3):
        observation = env.step({"xyzrpy": move, "gripper": opening})[0]
        np.testing.assert_allclose(observation["target"]["tquat"][:3], first["tquat"][:3] + steps * move[:3], atol=1e-4)
    behind = observation["target"]["tquat"][:3] - observation["tquat"][:3]
    assert np.linalg.norm(behind) > 0.01  # a moving arm is behind its target
    for _ in range(8):
        observation = env.step({"xyzrpy": np.zeros(6), "gripper": opening})[0]
    assert (distance(observation["tquat"], observation["target"]["tquat"]) < 5e-3).all()


def test_only_a_copy_that_starts_anew_has_a_new_target() -> None:
    envs = rcs.make_vec("Free", copies=2, autoreset="Disabled", **OPTIONS)
    first = envs.reset(seed=0)[0]
    move, opening = np.full((2, 6), 0.01), np.ones((2, 1), np.float32)
    before = [envs.step({"xyzrpy": move, "gripper": opening})[0] for _ in range(3)][-1]
    after = envs.reset(options={"reset_mask": np.array([True, False])})[0]
    np.testing.assert_array_equal(after["target"]["tquat"][0], first["tquat"][0])
    np.testing.assert_array_equal(after["target"]["tquat"][1], before["target"]["tquat"][1])


def test_on_joints_the_target_is_where_relative_actions_count_from() -> None:
    env = rcs.make("Free", control="joints", layers=[ObserveTarget])
    observation = env.reset(seed=0)[0]
    assert env.observation_space.contains(observation)
    np.testing.assert_array_equal(observation["target"]["joints"], observation["joints"])
    move, opening = np.full(7, 0.02), np.ones(1, np.float32)
    for _ in range(3):
        before = observation["target"]["joints"]
        observation, *_, info = env.step({"joints": move, "gripper": opening})
        np.testing.assert_allclose(observation["target"]["joints"], before + move, atol=1e-12)
        np.testing.assert_array_equal(observation["target"]["joints"], info["target"]["joints"])
