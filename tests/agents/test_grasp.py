"""Grasps from above: the tool points down where an arm can, and leans where it must."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents import PickExpert
from rcs.agents.grasp import CLEARANCE, are_still, plan_from_above
from rcs.rollout.episode import run_episode
from rcs.spatial import Pose


def planned(robot: str, seed: int) -> tuple[PickExpert, dict[str, Pose], Pose]:
    """Return the expert, its plan and the cuboid of an episode, all in the base frame."""
    env = rcs.make("PickCuboid", robot=robot)
    expert = PickExpert(env)
    observation, info = env.reset(seed=seed)
    expert.reset(observation, info)
    plan = {name: Pose.from_tquat(tcp) for name, tcp in expert.arms[0].plan.items()}
    return expert, plan, Pose.from_tquat(info["cuboid"])


@pytest.mark.parametrize("robot", ["fr3", "ur5e", "so101"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_poses_stand_above_each_other_and_the_fingers_close_across_the_cuboid(robot: str, seed: int) -> None:
    _, plan, cuboid = planned(robot, seed)
    for name, height in (("grasp", 0.0), ("above", CLEARANCE), ("lifted", 0.15)):
        expected = cuboid.translation + [0.0, 0.0, height]
        np.testing.assert_allclose(plan[name].translation, expected, atol=1e-3, err_msg=name)
    along = plan["grasp"].matrix[:3, 1] @ cuboid.matrix[:3, 1]
    assert abs(along) > np.cos(np.deg2rad(20.0))


@pytest.mark.parametrize("robot", ["fr3", "ur5e"])
def test_an_arm_with_six_joints_or_more_points_straight_down(robot: str) -> None:
    _, plan, _ = planned(robot, 4)
    for name in ("above", "grasp", "lifted"):
        np.testing.assert_allclose(plan[name].matrix[:3, 2], [0.0, 0.0, -1.0], atol=1e-9)


def test_an_arm_with_five_joints_leans_as_far_as_it_must_and_its_poses_can_be_reached() -> None:
    expert, plan, _ = planned("so101", 4)
    arm = expert.arms[0]
    for name in ("above", "grasp", "lifted"):
        assert plan[name].matrix[2, 2] < 0.05, "the tool points down or to the side, not up"
        assert arm.writer.write(plan[name].tquat, 1.0) is not None


@pytest.mark.parametrize("robot", ["so101", "ur5e"])
def test_the_expert_picks_on_other_arms(robot: str) -> None:
    env = rcs.make("PickCuboid", robot=robot)
    expert = PickExpert(env)
    assert all(run_episode(env, expert, seed=seed).success for seed in range(4))


def test_the_first_feasible_group_of_turns_is_taken_and_the_smaller_motion_in_it() -> None:
    expert, plan, cuboid = planned("fr3", 0)
    arm = expert.arms[0]
    yaw = float(np.arctan2(plan["grasp"].matrix[1, 0], plan["grasp"].matrix[0, 0]))

    def turn_of(turns: Any) -> float:
        found = plan_from_above(arm, cuboid, turns)
        assert found is not None
        return float(Pose.from_tquat(found["grasp"]).matrix[:2, 0] @ plan["grasp"].matrix[:2, 0])

    assert turn_of([[yaw + np.pi, yaw]]) == pytest.approx(1.0)
    assert turn_of([[yaw + 0.5], [yaw]]) == pytest.approx(np.cos(0.5))


def test_what_is_out_of_reach_has_no_plan() -> None:
    for robot in ("fr3", "so101"):
        expert, _, _ = planned(robot, 0)
        assert plan_from_above(expert.arms[0], Pose((3.0, 0.0, 0.0)), [[0.0, 1.0]]) is None


def test_a_reading_of_the_gripper_that_is_seen_twice_does_not_show_that_it_stands_still() -> None:
    env = rcs.make("PickCuboid", robot="fr3")
    expert = PickExpert(env)
    observation, info = env.reset(seed=0)
    expert.reset(observation, info)
    (arm,) = expert.arms

    def see(opening: float, step: int, age: float) -> bool:
        own = {**observation, "gripper": np.array([opening])}
        arm.see(own, {**info, "time": info["time"] + step / 30, "ages": {"gripper": age}})
        return are_still(expert)

    assert not see(0.8, 1, 0.001)
    assert not see(0.7, 2, 0.001)
    assert not see(0.7, 3, 0.0344), "the hand, which sends 30 states a second, has sent none"
    assert not see(0.6, 4, 0.001)
    assert see(0.6, 5, 0.001)
