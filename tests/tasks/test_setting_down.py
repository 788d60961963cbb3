"""Place and StackCuboid: what counts as set down, what does not, and experts that do it on every arm."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents import agent_for
from rcs.errors import InvalidSetup
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.rollout.episode import run_episode
from rcs.rollout.replay import replay
from rcs.spatial import Pose
from rcs.tasks import Place, StackCuboid
from rcs.tasks.place import APART
from rcs.testing.env_contract import require_same_bits

both = pytest.mark.parametrize("task", ["Place", "StackCuboid"])
ARMS = [("fr3", None), ("so101", None), ("ur5e", None), ("xarm7", "robotiq_2f85")]


def still(env: Any) -> dict[str, Any]:
    action = {key: np.zeros(space.shape, space.dtype) for key, space in env.action_space.spaces.items()}
    action["gripper"][...] = 1.0
    return action


@both
@pytest.mark.parametrize(("robot", "gripper"), ARMS)
@pytest.mark.parametrize("stepping", ["async", "sync"])
def test_the_expert_sets_the_cuboid_down(task: str, robot: str, gripper: str | None, stepping: Any) -> None:
    env = rcs.make(task, robot=robot, end_effector=gripper, stepping=stepping, reward="sparse")
    result = run_episode(env, agent_for(env), seed=8)
    assert result.success
    assert result.reward == 1.0


@both
def test_a_cuboid_that_only_lies_there_was_not_set_down(task: str) -> None:
    env = rcs.make(task)
    _, info = env.reset(seed=3)
    goal = info["goal"]
    env.reset(
        options={
            "objects": {"cuboid": goal, **{k: v for k, v in env.simulation.object_poses().items() if k != "cuboid"}}
        }
    )
    for _ in range(40):
        *_, info = env.step(still(env))
        assert not info["success"]
    np.testing.assert_allclose(info["cuboid"][:3], info["goal"][:3], atol=2e-3)
    assert not info["is_touched"]


@both
def test_a_cuboid_that_is_dropped_onto_its_goal_was_not_set_down(task: str) -> None:
    """It falls from 4 cm, lies where it belongs, and does not count."""
    env = rcs.make(task, control="tquat", max_episode_steps=500)
    expert = agent_for(env)
    observation, info = env.reset(seed=5)
    expert.reset(observation, info)
    is_dropped = False
    for _ in range(400):
        action = expert.act(observation, info)
        if expert.phase == "lower" and info["cuboid"][2] - info["goal"][2] < 0.045:
            is_dropped = True
        if is_dropped:
            action = {
                **action,
                "tquat": np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]),
                "gripper": np.ones(1, np.float32),
            }
        observation, _, terminated, truncated, info = env.step(action)
        if is_dropped and np.linalg.norm(info["cuboid"][:3] - info["goal"][:3]) < 0.01 and not info["is_touched"]:
            break
        assert not terminated
    else:
        pytest.fail("the cuboid never lay where it belongs")
    assert is_dropped
    for _ in range(40):
        *_, info = env.step({**action, "gripper": np.ones(1, np.float32)})
        assert not info["success"]


@both
def test_it_must_be_let_go_and_lie_still_for_the_rest_time(task: str) -> None:
    env = rcs.make(task, task_options={"rest_time": 1.0})
    expert = agent_for(env)
    observation, info = env.reset(seed=2)
    expert.reset(observation, info)
    released, is_over = None, False
    while not is_over:
        observation, _, is_over, truncated, info = env.step(expert.act(observation, info))
        assert not truncated
        if info["is_touched"] or info["is_grasped"]:
            released = info["time"]
    assert released is not None
    assert info["time"] - released >= 1.0 - 0.05
    assert Pose.from_tquat(info["cuboid"]).matrix[2, 2] == pytest.approx(1.0, abs=1e-3)


@both
def test_a_copy_of_a_batch_is_the_single_environment_bit_for_bit(task: str) -> None:
    setup = rcs.Setup(task=task, randomisation=rcs.Randomisation())
    single, batch = rcs.make(setup), rcs.make_vec(setup, copies=3, threads=2)
    one, told = single.reset(seed=12)
    many, all_told = batch.reset(seed=10)
    require_same_bits(one, {key: value[2] for key, value in many.items()})
    actions = batch.action_space.sample()
    for _ in range(10):
        many, rewards, _, _, all_told = batch.step(actions)
        one, reward, _, _, told = single.step({key: value[2] for key, value in actions.items()})
        assert reward == rewards[2]
    require_same_bits(one, {key: value[2] for key, value in many.items()})
    for key in ("cuboid", "goal"):
        np.testing.assert_array_equal(told[key], all_told[key][2])
    np.testing.assert_array_equal(single.simulation.world.states(), batch.simulation.world.states()[2])


@both
def test_a_recorded_episode_replays_bit_for_bit(task: str, tmp_path: Path) -> None:
    collection = Collection(setup=rcs.Setup(task=task), out=tmp_path / "some", episodes=1, seed=3)
    for _ in collect(collection, Progress()):
        pass
    assert all(result.is_equal for result in replay(tmp_path / "some"))


def test_places_are_random_in_the_area_and_apart_from_each_other() -> None:
    envs = rcs.make_vec("Place", copies=300, threads=1)
    _, info = envs.reset(seed=0)
    area = envs.simulation.task.area
    for key in ("cuboid", "goal"):
        offset = np.abs(info[key][:, :2] - area.center)
        assert (offset <= np.array(area.size) / 2).all()
        assert (offset.max(axis=0) > 0.45 * np.array(area.size)).all()
    assert np.linalg.norm(info["cuboid"][:, :2] - info["goal"][:, :2], axis=1).min() >= APART


def test_the_goal_is_as_high_as_the_cuboids_of_the_episode() -> None:
    ranges = rcs.Randomisation.off(object_size=(1.1, 1.1))
    for task, layers in (("Place", 1), ("StackCuboid", 3)):
        _, info = rcs.make(task, randomisation=ranges).reset(seed=0)
        assert info["goal"][2] == pytest.approx(layers * 1.1 * 0.0576 / 2)


@both
def test_both_objects_can_be_put_somewhere(task: str) -> None:
    env = rcs.make(task)
    env.reset(seed=0)
    poses = env.simulation.object_poses()
    wanted = {name: pose + [0.01 * (i + 1), -0.02, 0, 0, 0, 0, 0] for i, (name, pose) in enumerate(poses.items())}
    env.reset(seed=1, options={"objects": wanted})
    for name, pose in env.simulation.object_poses().items():
        np.testing.assert_allclose(pose, wanted[name], atol=1e-9)


@pytest.mark.parametrize("value", [0.0, -1.0])
def test_times_and_tolerances_that_make_no_sense_are_refused(value: float) -> None:
    for task, names in ((Place, ("rest_time", "tolerance")), (StackCuboid, ("rest_time",))):
        for name in names:
            with pytest.raises(InvalidSetup, match=f"{name} is .*above 0"):
                task.parse_options({name: value})


@both
def test_it_takes_one_robot_with_a_gripper(task: str) -> None:
    for robot in ("dual_fr3", "xarm7"):
        with pytest.raises(InvalidSetup, match="one robot with a gripper"):
            rcs.make(task, robot=robot)
