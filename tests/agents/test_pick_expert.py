"""The scripted expert picks the cuboid with every kind of action, and says why when it cannot."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents import PickExpert, agent_for
from rcs.agents.action_writer import difference
from rcs.envs.layers.relative import shift
from rcs.errors import WrongOrder
from rcs.rollout.episode import run_episode
from rcs.spatial import Pose

KINDS = [
    *((control, how) for control in ("joints", "tquat", "xyzrpy") for how in ("last_step", "origin", "absolute")),
    ("twist", "last_step"),
]


@pytest.mark.parametrize(("control", "relative"), KINDS)
def test_the_expert_succeeds_with_every_kind_of_action(control: Any, relative: Any) -> None:
    setup = rcs.Setup(control=control, relative=relative)
    env = rcs.make(setup)
    result = run_episode(env, agent_for(env), seed=5)
    env.close()
    assert result.success
    assert result.failure is None


def test_the_expert_succeeds_under_a_layer_that_keeps_the_tilt() -> None:
    env = rcs.make(rcs.Setup(control="xyzrpy", relative="last_step", layers=("KeepTilt",)))
    result = run_episode(env, agent_for(env), seed=5)
    env.close()
    assert result.success


def test_the_expert_succeeds_with_synchronous_steps() -> None:
    setup = rcs.Setup(stepping="sync")
    env = rcs.make(setup)
    assert run_episode(env, agent_for(env), seed=1).success


def test_the_expert_grasps_at_every_corner_of_the_workspace_and_every_yaw() -> None:
    setup = rcs.Setup()
    env = rcs.make(setup)
    expert = agent_for(env)
    world = env.simulation.world
    cuboid = int(world.model.joint("cuboid").qposadr[0])
    for x in (0.35, 0.65):
        for y in (-0.2, 0.2):
            for yaw in (0.1, 1.5, 2.9):
                env.reset(seed=0)
                world.qpos[cuboid : cuboid + 2] = x, y
                world.qpos[cuboid + 3 : cuboid + 7] = np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)
                observation, info = env.reset(options={"state": world.states()})
                expert.reset(observation, info)
                over = False
                while not over:
                    observation, _, terminated, over, info = env.step(expert.act(observation, info))
                    over = over or terminated
                assert info["success"], (x, y, yaw, expert.failure)


def test_a_cuboid_out_of_reach_is_an_ik_failure() -> None:
    setup = rcs.Setup(max_episode_steps=5)
    env = rcs.make(setup)
    expert = agent_for(env)
    observation, info = env.reset(seed=0)
    far = info["cuboid"].copy()
    far[0] = 1.5
    expert.reset(observation, {**info, "cuboid": far})
    assert expert.failure == "ik"
    action = expert.act(observation, info)
    assert env.action_space.contains(action), "it gives valid actions all the same"


def test_a_gripper_that_closes_on_nothing_is_a_no_contact_failure() -> None:
    setup = rcs.Setup()
    env = rcs.make(setup)
    expert = agent_for(env)
    observation, info = env.reset(seed=0)
    wrong = info["cuboid"].copy()
    wrong[:2] += (0.0, 0.12) if wrong[1] < 0 else (0.0, -0.12)
    over = False
    expert.reset(observation, {**info, "cuboid": wrong})
    while not over:
        observation, _, terminated, truncated, info = env.step(expert.act(observation, {**info, "cuboid": wrong}))
        over = terminated or truncated
    assert not info["success"]
    assert expert.failure == "no_contact"


def test_without_a_cuboid_the_expert_says_which_task_it_is_for() -> None:
    setup = rcs.Setup(task="Free")
    env = rcs.make(setup)
    expert = PickExpert(env)
    observation, info = env.reset(seed=0)
    with pytest.raises(WrongOrder, match="PickCuboid"):
        expert.reset(observation, info)


def test_difference_is_what_shift_applies() -> None:
    rng = np.random.default_rng(0)
    for _ in range(50):
        start, goal = (Pose.from_rotvec(rng.uniform(-1, 1, 3), rng.uniform(-2, 2, 3)).tquat for _ in range(2))
        np.testing.assert_allclose(shift(start, difference(start, goal)), goal, atol=1e-12)
