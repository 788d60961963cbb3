"""Teachers remember nothing, and do their task from wherever the arm was brought."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents import PickTeacher, PlaceTeacher
from rcs.agents.grasp import closing_yaw
from rcs.envs.setup import Setup
from rcs.envs.vector import VecEnv
from rcs.errors import InvalidSetup
from rcs.spatial import compose, tquat_to_matrix
from rcs.tasks.pick_cuboid import POSES, SIZE

PICK = Setup(
    task="PickCuboid",
    frequency=10.0,
    max_episode_steps=100,
    observe=("privileged", "contacts"),
    layers=("ObserveTarget",),
    collision_reaction=False,
)
PLACE = replace(PICK, task="Place", max_episode_steps=120)


def row(observation: Any, copy: int) -> Any:
    if isinstance(observation, dict):
        return {key: row(value, copy) for key, value in observation.items()}
    return observation[copy]


def succeed(envs: VecEnv, teacher: PickTeacher, observation: Any, steps: int) -> np.ndarray:
    done = np.zeros(envs.num_envs, bool)
    for _ in range(steps):
        observation, _, terminated, truncated, _ = envs.step(teacher.act(observation, {}))
        done |= terminated
        if (is_over := terminated | truncated).any():
            observation, _ = envs.reset(options={"reset_mask": is_over})
        if done.all():
            break
    return done


@pytest.mark.parametrize(("setup", "kind", "steps"), [(PICK, PickTeacher, 60), (PLACE, PlaceTeacher, 70)])
def test_it_succeeds_in_every_copy(setup: Setup, kind: type[PickTeacher], steps: int) -> None:
    envs = rcs.make_vec(setup, copies=8, autoreset="Disabled")
    observation, _ = envs.reset(seed=0)
    assert succeed(envs, kind(envs), observation, steps).all()


def test_it_picks_the_cuboid_after_somebody_else_acted() -> None:
    envs = rcs.make_vec(PICK, copies=8, autoreset="Disabled")
    teacher, rng = PickTeacher(envs), np.random.default_rng(0)
    observation, _ = envs.reset(seed=20)
    for _ in range(18):  # to the cuboid, with the gripper closing and opening on the way
        action = teacher.act(observation, {})
        action["joints"] = action["joints"] + rng.normal(0.0, 0.01, (8, 7))
        action["gripper"] = rng.integers(0, 2, (8, 1)).astype(np.float32)
        space: Any = envs.single_action_space
        bound = space["joints"].high
        action["joints"] = np.clip(action["joints"], -bound, bound)
        observation, _, _, truncated, _ = envs.step(action)
        assert not truncated.any()
    assert succeed(envs, teacher, observation, 80).sum() >= 7  # one may have been thrown off the table


def test_it_sets_the_cuboid_down_after_somebody_else_acted() -> None:
    envs = rcs.make_vec(PLACE, copies=8, autoreset="Disabled")
    teacher, rng = PlaceTeacher(envs), np.random.default_rng(0)
    observation, _ = envs.reset(seed=20)
    space: Any = envs.single_action_space
    bound = space["joints"].high
    for step in range(22):  # to the cuboid and up, dropped now and then, but not onto the mark
        action = teacher.act(observation, {})
        action["joints"] = np.clip(action["joints"] + rng.normal(0.0, 0.01, (8, 7)), -bound, bound)
        action["gripper"] = np.where(step % 5 == 4, 1.0 - action["gripper"], action["gripper"])
        observation, _, _, truncated, _ = envs.step(action)
        assert not truncated.any()
    assert succeed(envs, teacher, observation, 90).sum() >= 7  # one may have been thrown off the table


@pytest.mark.parametrize(("setup", "kind", "steps"), [(PICK, PickTeacher, 20), (PLACE, PlaceTeacher, 30)])
def test_an_action_follows_from_the_observation_alone_and_is_that_of_one_copy(
    setup: Setup, kind: type[PickTeacher], steps: int
) -> None:
    envs, env = rcs.make_vec(setup, copies=4, autoreset="Disabled"), rcs.make(setup)
    teacher, alone = kind(envs), kind(env)
    observation, _ = envs.reset(seed=3)
    for _ in range(steps):
        action = teacher.act(observation, {})
        for copy in range(4):
            own = alone.act(row(observation, copy), {})
            assert env.action_space.contains(own)
            for key, value in own.items():
                np.testing.assert_array_equal(value, action[key][copy])
        observation, *_ = envs.step(action)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"task": "Push"}, "is for PickCuboid"),
        ({"control": "xyzrpy"}, "control='xyzrpy'"),
        ({"relative": "absolute"}, "relative='absolute'"),
        ({"observe": ("privileged",)}, "'contacts'"),
        ({"layers": ()}, "ObserveTarget"),
    ],
)
def test_another_setup_is_refused(options: dict[str, Any], message: str) -> None:
    env = rcs.make(replace(PICK, **options))
    with pytest.raises(InvalidSetup, match=message):
        PickTeacher(env)


def test_another_task_than_place_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="PlaceTeacher is for Place"):
        PlaceTeacher(rcs.make(PICK))


@pytest.mark.parametrize("lying", list(POSES.values()), ids=list(POSES))
def test_jaws_turn_with_the_box_and_close_across_its_shorter_level_edge(lying: tuple[float, ...]) -> None:
    turn = np.random.default_rng(0).uniform(-np.pi, np.pi, 50)
    about_z = np.zeros((50, 7))
    about_z[:, 5], about_z[:, 6] = np.sin(turn / 2), np.cos(turn / 2)
    pose = compose(about_z, (0.0, 0.0, 0.0, *lying))
    yaw = closing_yaw(pose, SIZE)
    # Jaws move along the tool's y axis, which Rz(yaw) Rx(pi) turns to (sin yaw, -cos yaw, 0).
    jaws = np.stack([np.sin(yaw), -np.cos(yaw), np.zeros(50)], -1)
    along = np.abs(np.einsum("nij,ni->nj", tquat_to_matrix(pose)[:, :3, :3], jaws))
    level = np.delete(SIZE, np.argmax(np.abs(tquat_to_matrix(pose)[0, 2, :3])))
    assert (np.array(SIZE)[along.argmax(-1)] == level.min()).all()
    np.testing.assert_allclose(along.max(-1), 1.0, atol=1e-9)
