"""Starts that are not left to the task: robots and objects stand where they are put, and nonsense is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs.assemble import assemble
from rcs.errors import InvalidSetup
from rcs.robots.description import Mount
from rcs.setups.make import resolve
from rcs.spatial import Pose

TASKS = {"PickCuboid": "fr3", "PickToy": "xarm7", "LiftBar": "dual_fr3"}


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("randomisation", [None, True])
def test_objects_put_where_they_are_told_to_be_are_where_they_were(task: str, randomisation: Any) -> None:
    env = rcs.make(task, robot=TASKS[task], randomisation=randomisation)
    env.reset(seed=3)
    state, poses = env.simulation.world.states(), env.simulation.object_poses()
    env.reset(seed=3, options={"objects": poses})
    # The soft toy's yaw is that of a line through its nodes, which sag.
    np.testing.assert_allclose(env.simulation.world.states(), state, atol=1e-5 if task == "PickToy" else 0.0)


@pytest.mark.parametrize("task", TASKS)
def test_objects_are_where_they_are_put(task: str) -> None:
    env = rcs.make(task, robot=TASKS[task])
    env.reset(seed=0)
    ((name, pose),) = env.simulation.object_poses().items()
    wanted = pose + np.array([0.03, -0.02, 0.01, 0, 0, 0, 0])
    wanted[3:] = [0.0, 0.0, np.sin(0.1), np.cos(0.1)]
    _, info = env.reset(seed=0, options={"objects": {name: wanted}})
    np.testing.assert_allclose(env.simulation.object_poses()[name], wanted, atol=1e-4)
    told = next(value for key, value in info.items() if key.startswith(name))
    np.testing.assert_allclose(told, wanted, atol=1e-4)


def test_poses_are_in_the_base_frame_of_a_single_robot() -> None:
    parts = resolve(rcs.Setup())
    base = Pose((0.1, -0.2, 0.05), (0.0, 0.0, np.sin(0.2), np.cos(0.2)))
    mount = Mount(translation=tuple(base.translation), quaternion=tuple(base.quaternion))
    robot = replace(parts.robots[0], base_in_scene=mount)
    env = assemble(replace(parts, robots=(robot,)))
    wanted = np.array([0.45, 0.1, -0.02, 0.0, 0.0, 0.0, 1.0])
    _, info = env.reset(seed=0, options={"objects": {"cuboid": wanted}})
    np.testing.assert_allclose(info["cuboid"], wanted, atol=1e-12)
    np.testing.assert_allclose(env.simulation.object_poses()["cuboid"], wanted, atol=1e-12)


def test_a_robot_stands_where_it_is_put_and_stays_there() -> None:
    env = rcs.make("Free", robot="fr3", control="joints", relative=False)
    joints = np.array([0.3, -0.4, 0.1, -2.0, 0.2, 1.7, 0.5])
    observation, _ = env.reset(seed=0, options={"robot": {"joints": joints, "gripper": [0.4]}})
    np.testing.assert_allclose(observation["joints"], joints, atol=1e-12)
    np.testing.assert_allclose(observation["gripper"], 0.4, atol=1e-6)
    env.simulation.world.advance()
    np.testing.assert_allclose(env.simulation.robots[0].joints, joints, atol=2e-3)
    np.testing.assert_allclose(env.simulation.robots[0].opening, 0.4, atol=0.02)


def test_of_two_robots_one_can_be_put_and_the_other_stays_at_home() -> None:
    env = rcs.make("LiftBar", robot="dual_fr3")
    home, _ = env.reset(seed=0)
    joints = home["left"]["joints"] + 0.1
    observation, _ = env.reset(seed=0, options={"robot": {"left": {"joints": joints}}})
    np.testing.assert_allclose(observation["left"]["joints"], joints, atol=1e-12)
    np.testing.assert_array_equal(observation["right"]["joints"], home["right"]["joints"])


def test_a_hand_stands_as_it_is_put() -> None:
    env = rcs.make("PickToy", robot="xarm7", binary_gripper=False)
    home, _ = env.reset(seed=0)
    hand = np.clip(home["hand"] + 0.1, 0.0, 1.0)
    observation, _ = env.reset(seed=0, options={"robot": {"joints": home["joints"], "hand": hand}})
    np.testing.assert_allclose(observation["hand"], hand, atol=1e-6)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"objects": {"cube": [0.5, 0, 0, 0, 0, 0, 1]}}, "cuboid"),
        ({"objects": {"cuboid": [0.5, 0, 0]}}, "7 numbers"),
        ({"objects": {"cuboid": [0.5, 0, 0, 0, 0, 0, 0]}}, "quaternion"),
        ({"objects": {"cuboid": [np.nan, 0, 0, 0, 0, 0, 1]}}, "7 numbers"),
        ({"objects": 3}, "cuboid"),
        ({"robot": {"gripper": [1.0]}}, "joints"),
        ({"robot": {"joints": [0.0] * 3}}, "shape"),
        ({"robot": {"joints": [9.0] * 7}}, "valid is"),
        ({"robot": {"joints": [0.0] * 7, "hand": [0.0]}}, "joints"),
        ({"robot": 3}, "robot"),
        ({"robots": {}}, "Did you mean .robot"),
    ],
)
def test_a_start_that_makes_no_sense_is_refused(options: dict[str, Any], words: str) -> None:
    env = rcs.make("PickCuboid")
    with pytest.raises(InvalidSetup, match=words):
        env.reset(seed=0, options=options)


def test_a_state_says_all() -> None:
    env = rcs.make("PickCuboid")
    env.reset(seed=0)
    state, poses = env.simulation.world.states(), env.simulation.object_poses()
    with pytest.raises(InvalidSetup, match="cannot be combined"):
        env.reset(seed=0, options={"state": state, "objects": poses})
