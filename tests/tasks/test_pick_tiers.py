"""Harder cuboids: among distractors, flat, standing, of any size, and in a larger area."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents import agent_for
from rcs.envs.task import Area
from rcs.errors import InvalidSetup
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.rollout.episode import run_episode
from rcs.rollout.replay import replay
from rcs.setups import lab_of
from rcs.tasks.pick_cuboid import FREE, NEAR, SIZE, PickCuboid

HARDEST = {"distractors": 4, "pose": "any", "edges": "random", "area": "large"}
TIERS: list[dict[str, Any]] = [
    {"distractors": 4},
    {"pose": "flat"},
    {"pose": "standing"},
    {"pose": "any", "edges": "random"},
    {"area": "large"},
    HARDEST,
]


@pytest.mark.parametrize("options", [{"pose": "standing"}, {"pose": "flat"}, HARDEST], ids=str)
def test_the_expert_picks_it(options: dict[str, Any]) -> None:
    env = rcs.make("PickCuboid", task_options=options)
    assert run_episode(env, agent_for(env), seed=1).success


def test_an_arm_with_five_joints_picks_the_hardest() -> None:
    env = rcs.make("PickCuboid", robot="so101", task_options=HARDEST)
    assert run_episode(env, agent_for(env), seed=1).success


@pytest.mark.parametrize("options", TIERS, ids=str)
def test_everything_starts_at_rest(options: dict[str, Any]) -> None:
    env = rcs.make("PickCuboid", task_options=options)
    env.reset(seed=5)
    world = env.simulation.world
    start = world.qpos.copy()
    still = {key: np.zeros(space.shape, space.dtype) for key, space in env.action_space.spaces.items()}
    still["gripper"][:] = 1.0
    for _ in range(30):
        env.step(still)
    np.testing.assert_allclose(world.qpos[9:], start[9:], atol=2e-3)


@pytest.mark.parametrize(("pose", "up"), [("usual", 2), ("flat", 1), ("standing", 0)])
def test_the_named_axis_points_up_and_the_lowest_corner_is_on_the_table(pose: str, up: int) -> None:
    envs = rcs.make_vec("PickCuboid", copies=8, threads=1, task_options={"pose": pose, "edges": "random"})
    _, info = envs.reset(seed=0)
    for tquat, edges in zip(info["cuboid"], info["edges"], strict=True):
        assert abs(rcs.Pose.from_tquat(tquat).matrix[2, up]) == pytest.approx(1.0)
        assert tquat[2] == pytest.approx(edges[up] / 2)
    assert (np.abs(info["edges"] / SIZE - 0.9) <= 0.2 + 1e-9).all()
    assert len(np.unique(info["edges"])) == 24


def test_any_pose_is_each_of_the_three() -> None:
    envs = rcs.make_vec("PickCuboid", copies=24, threads=1, task_options={"pose": "any"})
    _, info = envs.reset(seed=0)
    ups = {int(np.argmax(np.abs(rcs.Pose.from_tquat(tquat).matrix[2, :3]))) for tquat in info["cuboid"]}
    assert ups == {0, 1, 2}


def test_distractors_leave_room_for_a_gripper_and_lie_near() -> None:
    envs = rcs.make_vec("PickCuboid", copies=16, threads=1, task_options={"distractors": 4})
    _, info = envs.reset(seed=0)
    model, qpos = envs.simulation.world.model, envs.simulation.world.qpos
    for i in range(4):
        first = int(model.joint(f"distractor {i}").qposadr[0])
        offset = qpos[:, first : first + 2] - info["cuboid"][:, :2]
        on_table = qpos[:, first + 2] > 0
        assert on_table.mean() > 0.9
        assert (np.linalg.norm(offset, axis=-1)[on_table] > FREE).all()
        assert (np.abs(offset)[on_table] <= NEAR + 1e-9).all()


def test_options_do_not_change_where_the_cuboid_starts() -> None:
    places = []
    for options in ({}, {"distractors": 4}, {"pose": "flat"}, {"edges": "random"}):
        _, info = rcs.make("PickCuboid", task_options=options).reset(seed=3)
        places.append(info["cuboid"][:2])
    for place in places[1:]:
        np.testing.assert_array_equal(place, places[0])


def test_copies_are_single_environments_bit_for_bit() -> None:
    envs = rcs.make_vec("PickCuboid", copies=2, threads=2, task_options=HARDEST, autoreset="Disabled")
    _, told = envs.reset(seed=6)
    singles = [rcs.make("PickCuboid", task_options=HARDEST) for _ in range(2)]
    for copy, single in enumerate(singles):
        _, own = single.reset(seed=6 + copy)
        np.testing.assert_array_equal(own["edges"], told["edges"][copy])
    for _ in range(8):
        envs.step({"joints": np.full((2, 7), 0.02), "gripper": np.zeros((2, 1), np.float32)})
        for single in singles:
            single.step({"joints": np.full(7, 0.02), "gripper": np.zeros(1, np.float32)})
    for copy, single in enumerate(singles):
        np.testing.assert_array_equal(single.simulation.world.states(), envs.simulation.world.states()[copy])


def test_a_recording_of_the_hardest_replays_bit_for_bit(tmp_path: Path) -> None:
    setup = rcs.Setup(task_options=HARDEST, randomisation=rcs.Randomisation())
    for attempt in collect(Collection(setup=setup, out=tmp_path / "hard", episodes=1, seed=3), Progress()):
        assert attempt.result.success
    assert all(result.is_equal for result in replay(tmp_path / "hard"))


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"distractors": 17}, "from 0 to 16"),
        ({"distractors": -1}, "from 0 to 16"),
        ({"distractors": 2.5}, "distractors is 2.5; valid: a whole number"),
        ({"pose": "upside down"}, "'standing'"),
        ({"edges": "huge"}, "'random'"),
        ({"area": "everywhere"}, "'large'"),
    ],
)
def test_options_that_make_no_sense_are_refused(options: dict[str, Any], text: str) -> None:
    with pytest.raises(InvalidSetup, match=text):
        PickCuboid.parse_options(options)


def test_a_lab_without_a_large_area_says_so() -> None:
    with pytest.raises(InvalidSetup, match="large_size"):
        PickCuboid(replace(Area(), large_size=None), {"area": "large"})


@pytest.mark.parametrize("robot", ["fr3", "ur5e", "xarm7", "so101"])
def test_large_areas_are_larger_and_on_the_table(robot: str) -> None:
    area = lab_of(robot).area
    large = area.enlarged()
    assert np.prod(large.size) > 1.2 * np.prod(area.size)
    assert abs(large.center[1]) + large.size[1] / 2 < 0.6
    assert large.center[0] + large.size[0] / 2 < 0.9
