"""Pick-Toy: a toy that gives way and lies still, and an expert that picks it with a hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rcs
from rcs.agents import ToyExpert
from rcs.envs.env import Env
from rcs.errors import InvalidSetup, WrongOrder
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress
from rcs.rollout.episode import run_episode
from rcs.rollout.replay import replay
from rcs.testing.env_contract import require_same_bits

SETUP = rcs.Setup(task="PickToy", robot="xarm7")


def still(env: Any) -> dict[str, NDArray[Any]]:
    action = {key: np.zeros(space.shape, space.dtype) for key, space in env.action_space.spaces.items()}
    action["gripper"][:] = 1.0
    return action


def nodes_of(env: Env) -> NDArray[np.float64]:
    """The toy's nodes in the scene, as MuJoCo has them."""
    world = env.simulation.world
    assert world.data is not None
    toy = world.model.body("toy").id
    return world.data.xpos[world.model.body_parentid == toy].copy()


def distances(nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    first, second = np.triu_indices(len(nodes), 1)
    return np.linalg.norm(nodes[first] - nodes[second], axis=-1)


def test_the_toy_lies_still_for_ten_seconds() -> None:
    env = rcs.make("PickToy", robot="xarm7", max_episode_steps=None)
    env.reset(seed=4)
    before = nodes_of(env)
    for _ in range(300):
        _, _, _, _, info = env.step(still(env))
        assert not info["is_touched"]
    np.testing.assert_allclose(nodes_of(env), before, atol=1e-3)
    assert np.isfinite(env.simulation.world.states()).all()


def test_every_start_is_the_same_toy_moved_and_turned() -> None:
    env = rcs.make(SETUP)
    area = env.simulation.task.area
    shapes, yaws = [], []
    for seed in range(20):
        _, info = env.reset(seed=seed)
        nodes, toy = nodes_of(env), info["toy"]
        np.testing.assert_allclose(nodes.mean(axis=0), toy[:3], atol=1e-12)
        assert (np.abs(toy[:2] - area.center) <= np.array(area.size) / 2).all()
        shapes.append(distances(nodes))
        yaws.append(2 * np.arctan2(toy[5], toy[6]))
        front = nodes[4:].mean(axis=0) - nodes[:4].mean(axis=0)
        np.testing.assert_allclose(np.arctan2(front[1], front[0]), yaws[-1], atol=1e-9)
    np.testing.assert_allclose(shapes, np.broadcast_to(shapes[0], np.shape(shapes)), atol=1e-12)
    assert np.ptp(yaws) > 3.0


def test_the_expert_lifts_the_toy_and_squeezes_it_by_more_than_a_twentieth() -> None:
    env = rcs.make(SETUP)
    expert = ToyExpert(env)
    for seed in range(3):
        env.reset(seed=seed)
        at_rest, low = distances(nodes_of(env)), nodes_of(env)[:, 2].mean()
        result = run_episode(env, expert, seed=seed)
        assert result.success, (seed, result.failure)
        assert result.failure is None
        held = nodes_of(env)
        assert held[:, 2].mean() - low > 0.10
        assert np.abs(distances(held) / at_rest - 1.0).max() > 0.05
        tcp = env.simulation.robots[0].tcp_tquat[:3]
        assert np.linalg.norm(tcp - expert.arms[0].plan["home"][:3]) < 0.05


@pytest.mark.parametrize(("control", "relative"), [("tquat", "absolute"), ("xyzrpy", "last_step")])
def test_the_expert_succeeds_with_poses_too(control: Any, relative: Any) -> None:
    setup = rcs.Setup(task="PickToy", robot="xarm7", control=control, relative=relative)
    env = rcs.make(setup)
    assert run_episode(env, ToyExpert(env), seed=5).success


def test_a_copy_of_a_batch_is_the_single_environment_bit_for_bit() -> None:
    single, batch = rcs.make(SETUP), rcs.make_vec(SETUP, copies=3)
    one, told = single.reset(seed=12)
    many, all_told = batch.reset(seed=10)
    require_same_bits(one, {key: value[2] for key, value in many.items()})
    np.testing.assert_array_equal(told["toy"], all_told["toy"][2])
    actions = batch.action_space.sample()
    actions["joints"] *= 0.3  # not against the table
    for _ in range(10):
        many, _, _, _, all_told = batch.step(actions)
        one, _, _, _, told = single.step({key: value[2] for key, value in actions.items()})
    require_same_bits(one, {key: value[2] for key, value in many.items()})
    np.testing.assert_array_equal(single.simulation.world.states(), batch.simulation.world.states()[2])
    np.testing.assert_array_equal(told["toy"], all_told["toy"][2])


def test_a_recorded_episode_replays_bit_for_bit(tmp_path: Path) -> None:
    collection = Collection(setup=SETUP, out=tmp_path / "toy", episodes=1, seed=3)
    for attempt in collect(collection, Progress()):
        assert attempt.result.success
    assert all(result.is_equal for result in replay(tmp_path / "toy"))


def test_a_toy_out_of_reach_is_an_ik_failure() -> None:
    env = rcs.make(SETUP)
    expert = ToyExpert(env)
    observation, info = env.reset(seed=0)
    far = info["toy"].copy()
    far[0] = 1.5
    expert.reset(observation, {**info, "toy": far})
    assert expert.failure == "ik"
    assert env.action_space.contains(expert.act(observation, info)), "it gives valid actions all the same"


def test_a_hand_that_closes_on_nothing_is_a_no_contact_failure() -> None:
    env = rcs.make(SETUP)
    expert = ToyExpert(env)
    observation, info = env.reset(seed=0)
    wrong = info["toy"].copy()
    wrong[1] -= np.copysign(0.25, wrong[1])
    expert.reset(observation, {**info, "toy": wrong})
    while expert.failure is None:
        observation, _, _, _, info = env.step(expert.act(observation, {**info, "toy": wrong}))
    assert expert.failure == "no_contact"


def test_the_task_and_its_expert_say_what_they_need() -> None:
    with pytest.raises(InvalidSetup, match="one robot"):
        rcs.make("PickToy", robot="dual_fr3")
    free = rcs.Setup(task="Free", robot="xarm7")
    env = rcs.make(free)
    observation, info = env.reset(seed=0)
    with pytest.raises(WrongOrder, match="PickToy"):
        ToyExpert(env).reset(observation, info)


@pytest.mark.gl
def test_the_first_frame_of_an_episode_shows_the_toy_where_it_lies() -> None:
    setup = rcs.Setup(task="PickToy", robot="xarm7", cameras=rcs.Cameras(names=("front",), image_size=(96, 96)))
    single, batch = rcs.make(setup), rcs.make_vec(setup, copies=2)
    one, _ = single.reset(seed=1)
    many, _ = batch.reset(seed=0)
    picture = one["frames"]["front"]["rgb"].astype(np.int64)
    red, green, blue = picture[..., 0], picture[..., 1], picture[..., 2]
    assert ((red > 2 * green - 20) & (red > 2 * blue + 60)).sum() > 15, "the toy is orange, nothing else is"
    np.testing.assert_array_equal(one["frames"]["front"]["rgb"], many["frames"]["front"]["rgb"][1])
