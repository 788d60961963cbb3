"""The parts that tasks of lifting share are the same for one copy and for many."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents import agent_for
from rcs.envs.assemble import assemble
from rcs.errors import InvalidSetup
from rcs.setups.make import resolve
from rcs.tasks.lift_bar import LiftBar
from rcs.tasks.lifting import lowest, norm, progress, upright
from rcs.tasks.pick_cuboid import PickCuboid
from rcs.tasks.pick_toy import PickToy

TASKS = [(PickCuboid, "fr3"), (LiftBar, "dual_fr3"), (PickToy, "xarm7")]
every_task = pytest.mark.parametrize(("task", "robot"), TASKS)


def parts_with(task: Any, robot: str, reward: Any = "shaped", **options: Any) -> Any:
    parts = resolve(rcs.Setup(task=task.__name__, robot=robot, reward=reward))
    return replace(parts, task=task(parts.task.area, options))


def episode(env: Any, seed: int) -> tuple[list[float], list[bool], list[Any]]:
    """Return rewards, successes and actions of an episode of the task's expert."""
    expert, rewards, successes, actions = agent_for(env), [], [], []
    observation, info = env.reset(seed=seed)
    expert.reset(observation, info)
    is_over = False
    while not is_over:
        actions.append(expert.act(observation, info))
        observation, reward, terminated, truncated, info = env.step(actions[-1])
        rewards.append(reward)
        successes.append(info["success"])
        is_over = terminated or truncated
    return rewards, successes, actions


@every_task
def test_a_sparse_reward_changes_nothing_but_the_reward(task: Any, robot: str) -> None:
    dense, sparse = (episode(assemble(parts_with(task, robot, reward=kind)), 3) for kind in ("dense", "sparse"))
    assert sparse[0] == [float(success) for success in sparse[1]] == [float(success) for success in dense[1]]
    assert sparse[0][-1] == 1.0
    assert dense[0][-1] == pytest.approx(100.0), "1 per step for ever, at a discount of 0.99"
    assert 0.0 < min(dense[0][:-1]) < max(dense[0][:-1]) <= 0.8


@every_task
def test_a_longer_hold_ends_so_much_later(task: Any, robot: str) -> None:
    short, long = (episode(assemble(parts_with(task, robot, hold_time=time)), 3) for time in (0.2, 1.4))
    assert len(long[0]) - len(short[0]) == pytest.approx(1.2 * 30, abs=1)
    for one, other in zip(short[0][:-1], long[0], strict=False):  # rewards
        assert one == other


def test_a_greater_height_is_reached_later() -> None:
    low, high = (episode(assemble(parts_with(PickCuboid, "fr3", lift_height=height)), 3) for height in (0.03, 0.12))
    assert len(low[0]) < len(high[0])


@pytest.mark.parametrize("value", [0.0, -0.1])
@pytest.mark.parametrize("name", ["lift_height", "hold_time"])
def test_heights_and_times_that_make_no_sense_are_refused(name: str, value: float) -> None:
    with pytest.raises(InvalidSetup, match=f"{name} is .*above 0"):
        PickCuboid.parse_options({name: value})


def test_a_hold_of_less_than_a_step_still_takes_one() -> None:
    env = assemble(parts_with(PickCuboid, "fr3", hold_time=1e-3))
    env.reset(seed=0)
    *_, info = env.step({"joints": np.zeros(7), "gripper": np.ones(1, np.float32)})
    assert not info["success"]


def test_progress_grows_from_0_to_1_with_each_of_its_parts() -> None:
    grasped = np.array([False, True])
    assert progress(np.array(np.inf), grasped, np.array(1.0)).tolist() == pytest.approx([0.0, 2 / 3])
    assert progress(np.array(0.0), grasped, np.array(-0.1)).tolist() == pytest.approx([1 / 3, 2 / 3])
    assert progress(np.array(0.0), grasped, np.array(1.1)).tolist() == pytest.approx([1 / 3, 1.0])
    near, far = progress(np.array([0.01, 0.02]), np.array(True), np.array(0.0))
    assert near > far


def test_every_centimetre_of_lifting_counts_alike() -> None:
    steps = np.diff(progress(np.zeros(11), np.ones(11, np.bool_), np.linspace(0.0, 1.0, 11)))
    np.testing.assert_allclose(steps, 1 / 30, atol=1e-12)


def test_the_lowest_corner_of_a_box_is_the_lowest_of_its_eight() -> None:
    rng = np.random.default_rng(0)
    halves = rng.uniform(0.01, 0.1, (20, 3))
    poses = np.stack([rcs.Pose.from_rotvec(rng.uniform(-1, 1, 3), rng.uniform(-2, 2, 3)).tquat for _ in range(20)])
    corners = np.array(list(product((-1.0, 1.0), repeat=3)))
    expected = [
        rcs.Pose.from_tquat(pose).apply(corners * half)[:, 2].min() for pose, half in zip(poses, halves, strict=True)
    ]
    np.testing.assert_allclose(lowest(poses, halves), expected, atol=1e-12)


def test_upright_poses_and_lengths_are_those_of_each_copy() -> None:
    rng = np.random.default_rng(0)
    places, heights = rng.uniform(-1, 1, (4, 3)), rng.uniform(0, 1, 4)
    for copy, pose in enumerate(upright(places, heights)):
        np.testing.assert_array_equal(pose, upright(places[copy], heights[copy]))
        assert rcs.Pose.from_tquat(pose).rpy == pytest.approx([0.0, 0.0, places[copy, 2]])
        assert norm(pose[3:6]) == np.sqrt(pose[5] ** 2)
