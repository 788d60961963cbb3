"""Push: the block must be pushed, not carried, thrown or dragged, and must lie on the goal at rest."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents import agent_for
from rcs.agents.push import Tip
from rcs.devices import lookup
from rcs.errors import InvalidSetup
from rcs.kinematics import kinematics_of
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.rollout.episode import run_episode
from rcs.rollout.replay import replay
from rcs.spatial import compose
from rcs.tasks.push import EDGES, FRICTION, MARGIN, SHORTEST_WAY, Push, PushOptions

ROBOTS = ("fr3", "ur5e", "xarm7", "so101")
HOLD = PushOptions().hold_time
DOWN = rcs.Pose.from_rpy((0.0, 0.0, 0.0), (np.pi, 0.0, 0.0)).quaternion


def still(env: Any) -> dict[str, Any]:
    """Return the action that changes nothing and keeps the gripper open."""
    action = {key: np.zeros(space.shape, space.dtype) for key, space in env.action_space.spaces.items()}
    action["gripper"][:] = 1.0
    return action


def at_goal(env: Any, seed: int = 0, **shift: float) -> tuple[Any, int]:
    """Reset, put the block at the goal, shifted by some metres; return the world and the block's place in `qpos`."""
    env.reset(seed=seed)
    world = env.simulation.world
    first = int(world.model.joint("block").qposadr[0])
    goal = env.simulation.object_poses()["goal"]
    world.qpos[first : first + 3] = goal[:3] + [shift.get("x", 0.0), shift.get("y", 0.0), EDGES[2] / 2]
    world.qpos[first + 2] += shift.get("z", 0.0)
    world.refresh()
    return world, first


@pytest.mark.parametrize(("robot", "stepping"), [*((robot, "async") for robot in ROBOTS), ("so101", "sync")])
def test_the_expert_pushes_with_every_arm(robot: str, stepping: Any) -> None:
    env = rcs.make("Push", robot=robot, stepping=stepping, reward="sparse")
    result = run_episode(env, agent_for(env), seed=2)
    assert result.success
    assert result.reward == 1.0


def test_the_expert_pushes_with_poses() -> None:
    env = rcs.make("Push", control="tquat")
    assert run_episode(env, agent_for(env), seed=4).success


def test_a_block_that_lies_at_the_goal_is_a_success_after_the_hold_time_and_not_before() -> None:
    env = rcs.make("Push", reward="sparse")
    world, _ = at_goal(env)
    start = float(world.time)
    for _ in range(40):
        _, reward, terminated, _, info = env.step(still(env))
        assert terminated == info["success"]
        if terminated:
            break
    assert info["success"]
    assert reward == 1.0
    # A step or two until the block has settled.
    assert HOLD - 1e-6 <= float(world.time) - start <= HOLD + 0.1


@pytest.mark.parametrize("shift", [{"x": 0.035}, {"y": -0.035}])
def test_a_block_beside_the_goal_is_no_success(shift: dict[str, float]) -> None:
    env = rcs.make("Push")
    at_goal(env, **shift)
    for _ in range(25):
        *_, info = env.step(still(env))
        assert not info["success"]


def test_a_block_that_slides_over_the_goal_is_no_success() -> None:
    env = rcs.make("Push", task_options={"tolerance": 0.05})
    world, first = at_goal(env)
    center = world.qpos[first : first + 2].copy()
    dof = int(world.model.joint("block").dofadr[0])
    for step in range(30):  # to and fro, always above the goal
        world.qvel[dof] = 0.2 * (-1.0) ** (step // 2)
        *_, info = env.step(still(env))
        assert np.abs(world.qpos[first : first + 2] - center).max() < 0.05
        assert not info["success"]
        assert not info["was_lifted"]


def test_a_block_that_was_lifted_over_is_no_success() -> None:
    env = rcs.make("Push", reward="dense")
    world, first = at_goal(env, z=0.05)
    total = 0.0
    for _ in range(40):
        _, reward, _, _, info = env.step(still(env))
        total += reward
    assert world.qpos[first + 2] == pytest.approx(EDGES[2] / 2, abs=1e-3)
    assert info["was_lifted"]
    assert not info["success"]
    assert total == 0.0


def test_a_block_that_was_thrown_is_no_success() -> None:
    env = rcs.make("Push")
    world, first = at_goal(env, x=-0.04)
    dof = int(world.model.joint("block").dofadr[0])
    world.qvel[dof : dof + 3] = [0.4, 0.0, 0.5]
    world.refresh()
    lifted = []
    for _ in range(60):
        *_, info = env.step(still(env))
        lifted.append(bool(info["was_lifted"]))
        assert not info["success"]
    assert lifted == sorted(lifted)
    assert lifted[-1]


def test_a_block_that_is_grasped_on_the_table_is_no_success() -> None:
    env = rcs.make("Push", relative=False)
    arm = env.robots["fr3"]
    kinematics = kinematics_of(arm.arm, arm.end_effector)
    low = kinematics.inverse(rcs.Pose((0.5, 0.0, 0.025), DOWN), np.array(arm.arm.home))
    block = np.array([0.5, 0.0, EDGES[2] / 2, 0.0, 0.0, 0.0, 1.0])
    goal = np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    start = {"robot": {"joints": low.joints}, "objects": {"block": block, "goal": goal}}
    env.reset(seed=0, options=start)
    grasp = {"joints": low.joints, "gripper": np.zeros(1, np.float32)}
    for _ in range(60):
        *_, info = env.step(grasp)
        assert not info["success"]
    assert info["was_lifted"]
    assert info["block"][2] == pytest.approx(EDGES[2] / 2, abs=4e-3)


def test_a_block_that_leans_is_no_success() -> None:
    env = rcs.make("Push")
    world, first = at_goal(env)
    assert env.simulation.evaluate().is_placed
    pose = env.simulation.object_poses()["block"]
    leaning = compose(pose, rcs.Pose.from_rpy((0.0, 0.0, 0.0), (np.deg2rad(7.0), 0.0, 0.0)).tquat)
    world.qpos[first + 2] = leaning[2] + 0.002
    world.qpos[first + 3 : first + 7] = leaning[[6, 3, 4, 5]]
    world.refresh()
    leans = env.simulation.evaluate()  # without a step, in which it would fall
    assert not leans.is_placed
    assert not leans.info["was_lifted"]


def test_a_new_episode_forgets_that_the_block_was_lifted() -> None:
    envs = rcs.make_vec("Push", copies=3, autoreset="Disabled")
    envs.reset(seed=0)
    task = envs.simulation.task
    assert isinstance(task, Push)
    task._was_lifted[:] = True
    _, info = envs.reset(options={"reset_mask": np.array([True, False, True])})
    np.testing.assert_array_equal(info["was_lifted"], [False, True, False])


@pytest.mark.parametrize("robot", ROBOTS)
def test_block_and_goal_lie_in_the_area_with_room_and_apart(robot: str) -> None:
    envs = rcs.make_vec("Push", robot=robot, copies=64, threads=1)
    envs.reset(seed=0)
    area = envs.simulation.task.area
    poses = envs.simulation.task.object_poses()
    half = np.array(area.size) / 2 - area.object_scale * MARGIN
    for pose in poses.values():
        assert (np.abs(pose[:, :2] - area.center) <= half + 1e-9).all()
    ways = np.linalg.norm(poses["goal"][:, :2] - poses["block"][:, :2], axis=-1)
    assert (ways >= area.object_scale * SHORTEST_WAY - 1e-9).all()
    assert len(np.unique(ways)) == 64


def test_copies_are_single_environments_bit_for_bit() -> None:
    envs = rcs.make_vec("Push", copies=2, threads=2, randomisation=True, autoreset="Disabled")
    _, told = envs.reset(seed=4)
    singles = [rcs.make("Push", randomisation=True) for _ in range(2)]
    for copy, single in enumerate(singles):
        _, own = single.reset(seed=4 + copy)
        for key in ("block", "goal", "edges"):
            np.testing.assert_array_equal(own[key], told[key][copy])
    for step in range(10):
        joints = np.full((2, 7), 0.01 * (step % 3))
        _, rewards, _, _, told = envs.step({"joints": joints, "gripper": np.zeros((2, 1), np.float32)})
        for copy, single in enumerate(singles):
            _, reward, _, _, own = single.step({"joints": joints[copy], "gripper": np.zeros(1, np.float32)})
            assert reward == rewards[copy]
            np.testing.assert_array_equal(own["block"], told["block"][copy])
    for copy, single in enumerate(singles):
        np.testing.assert_array_equal(single.simulation.world.states(), envs.simulation.world.states()[copy])


def test_a_recorded_push_replays_bit_for_bit(tmp_path: Path) -> None:
    setup = rcs.Setup(task="Push", randomisation=rcs.Randomisation())
    for attempt in collect(Collection(setup=setup, out=tmp_path / "pushes", episodes=1, seed=3), Progress()):
        assert attempt.result.success
    assert all(result.is_equal for result in replay(tmp_path / "pushes"))


def test_progress_is_greatest_at_the_goal() -> None:
    env, progress = rcs.make("Push"), []
    for x in (-0.08, -0.04, 0.0):
        at_goal(env, x=x)
        progress.append(env.simulation.task.evaluate().progress)
    assert 0.0 < progress[0] < progress[1] < progress[2] == 1.0


def test_the_block_slides_with_its_own_friction() -> None:
    world = rcs.make("Push").simulation.world
    block = world.model.geom("block")
    assert block.friction[0] == FRICTION
    assert block.priority[0] > world.model.geom("fr3/gripper/left_pad").priority[0]


def test_a_task_that_could_begin_done_is_refused() -> None:
    with rcs.make("Push", task_options={"tolerance": 0.13}) as env:
        for seed in range(20):
            assert not env.reset(seed=seed)[1]["success"]
            task = env.simulation.task
            assert np.linalg.norm((task.poses_of("block") - task.poses_of("goal"))[:2]) > 0.13
    with pytest.raises(InvalidSetup, match=r"too small for Push with a tolerance of 0\.15 m"):
        rcs.make("Push", task_options={"tolerance": 0.15})


@pytest.mark.parametrize("name", ["tolerance", "hold_time"])
def test_options_that_make_no_sense_are_refused(name: str) -> None:
    with pytest.raises(InvalidSetup, match=f"{name} is .*above 0"):
        Push.parse_options({name: 0.0})


def test_a_bare_flange_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="gripper or a hand"):
        rcs.make("Push", end_effector="none")


@pytest.mark.parametrize("name", [*lookup.names("gripper"), *lookup.names("hand")])
def test_the_tip_of_a_closed_tool_is_below_its_tcp_and_no_wider_than_a_hand(name: str) -> None:
    kind: Any = "gripper" if name in lookup.names("gripper") else "hand"
    tip = Tip.of(lookup.find(kind, name))
    assert 0.0 < tip.middle[2] < 0.05
    assert 0.005 < min(tip.half) <= max(tip.half) < 0.07
    tcp = np.array([0.4, 0.1, 0.3, *DOWN])
    np.testing.assert_allclose(tip.place(tcp), tcp[:3] + np.array(tip.middle) * [1, -1, -1], atol=1e-12)
