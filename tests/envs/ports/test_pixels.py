"""Learners see stacks of frames with channels first; copy i of a batch sees what a single environment sees."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

import rcs
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.sim.pixels import Pixels

COPIES, STEPS = 3, 7
SMALL: dict[str, Any] = {
    "task": "PickCuboid", "robot": "fr3",
    "cameras": rcs.Cameras(names=("side", "wrist"), image_size=(24, 20)), "max_episode_steps": 3
}  # fmt: skip
Image = NDArray[np.uint8]


def with_pixels(pixels: Any, fps: float | None = None, **options: Any) -> dict[str, Any]:
    return {**options, "cameras": replace(options["cameras"], pixels=pixels, fps=fps)}


def make_vec(pixels: Any = True, **options: Any) -> Any:
    envs = rcs.make_vec(copies=COPIES, **with_pixels(pixels, **{"threads": 2, **SMALL, **options}))
    envs.action_space.seed(3)
    return envs


def seen(observation: dict[str, Any], camera: str = "side") -> Image:
    return observation["frames"][camera]["pixels"]


def row(tree: Any, copy: int) -> Any:
    return {key: row(value, copy) for key, value in tree.items()} if isinstance(tree, dict) else tree[copy]


@pytest.mark.parametrize(
    "options",
    [
        {"threads": 1, "pixels": Pixels(stack=2)},
        {"threads": 3, "pixels": Pixels(grayscale=True, stack=3, valid_steps=1)},
        {"threads": 2, "pixels": Pixels(stack=2), "fps": 15.0},
        {"threads": 2, "pixels": Pixels(stack=2), "stepping": "sync", "max_episode_steps": 2},
        pytest.param({"threads": 2, "pixels": Pixels(), "randomisation": True}, marks=pytest.mark.gl),
    ],
    ids=["one thread", "grey, memory used again", "slow cameras", "synchronous", "late frames, textures"],
)
def test_one_copy_is_the_same_as_many(options: dict[str, Any]) -> None:
    envs = make_vec(**options)
    single_options = {key: value for key, value in {**SMALL, **options}.items() if key != "threads"}
    singles = [rcs.make(**with_pixels(**single_options)) for _ in range(COPIES)]
    observation, _ = envs.reset(seed=5)
    expected = [single.reset(seed=5 + copy)[0] for copy, single in enumerate(singles)]
    done = np.zeros(COPIES, np.bool_)
    for _ in range(STEPS):
        for copy in range(COPIES):
            for camera in SMALL["cameras"]:
                np.testing.assert_array_equal(seen(observation, camera)[copy], seen(expected[copy], camera))
        actions = envs.action_space.sample()
        observation, _, terminated, truncated, _ = envs.step(actions)
        for copy, single in enumerate(singles):
            expected[copy] = single.reset()[0] if done[copy] else single.step(row(actions, copy))[0]
        done = ~done & (terminated | truncated)
    for env in (envs, *singles):
        env.close()


def test_a_stack_moves_up_and_starts_with_its_first_frame() -> None:
    envs = make_vec(Pixels(stack=3), max_episode_steps=4)
    observation, _ = envs.reset(seed=0)
    before = seen(observation)
    assert before.shape == (COPIES, 9, 20, 24)
    assert envs.single_observation_space["frames"]["side"]["pixels"].shape == (9, 20, 24)
    np.testing.assert_array_equal(before[:, :3], before[:, 6:])
    is_over = np.zeros(COPIES, np.bool_)
    for _ in range(7):
        observation, _, terminated, truncated, _ = envs.step(envs.action_space.sample())
        now = seen(observation)
        for copy in range(COPIES):
            if is_over[copy]:
                np.testing.assert_array_equal(now[copy, :6], np.concatenate([now[copy, 6:]] * 2))
            else:
                np.testing.assert_array_equal(now[copy, :6], before[copy, 3:])
                assert (now[copy, 6:] != before[copy, 6:]).any()
        before, is_over = now, ~is_over & (terminated | truncated)
    envs.close()


def test_an_episode_that_ends_shows_its_last_frame_and_the_next_ones_first() -> None:
    envs = make_vec(Pixels(stack=2), autoreset=AutoresetMode.SAME_STEP, max_episode_steps=4)
    envs.reset(seed=0)
    envs.step(envs.action_space.sample())
    envs.reset(options={"reset_mask": np.array([False, True, False])})  # ends later than the others
    before = seen(envs.step(envs.action_space.sample())[0])
    observation, *_ = envs.step(envs.action_space.sample())
    assert (seen(observation)[:, :3] == before[:, 3:]).all()
    before = seen(observation)
    observation, _, _, truncated, info = envs.step(envs.action_space.sample())
    assert truncated.tolist() == [True, False, True]
    last, now = seen(info["final_obs"]), seen(observation)
    np.testing.assert_array_equal(last[:, :3], before[:, 3:])
    np.testing.assert_array_equal(now[1], last[1])
    for copy in (0, 2):
        np.testing.assert_array_equal(now[copy, :3], now[copy, 3:])
        assert (now[copy] != last[copy]).any()
    envs.close()


def test_a_reset_of_some_copies_leaves_what_the_others_see() -> None:
    envs = make_vec(Pixels(stack=2))
    envs.reset(seed=0)
    before = seen(envs.step(envs.action_space.sample())[0])
    now = seen(envs.reset(options={"reset_mask": np.array([False, True, False])})[0])
    np.testing.assert_array_equal(now[[0, 2]], before[[0, 2]])
    np.testing.assert_array_equal(now[1, :3], now[1, 3:])
    envs.close()


@pytest.mark.parametrize("options", [{}, {"fps": 15.0}], ids=["every step", "slow cameras"])
def test_a_state_goes_on_with_the_same_frames(options: dict[str, Any]) -> None:
    envs = make_vec(Pixels(stack=3, valid_steps=1), max_episode_steps=None, **options)
    envs.reset(seed=0)
    for _ in range(3):
        observation, *_ = envs.step(envs.action_space.sample())
    state, kept = envs.get_state(), seen(observation).copy()
    actions = [envs.action_space.sample() for _ in range(4)]
    first = [seen(envs.step(action)[0]).copy() for action in actions]
    np.testing.assert_array_equal(seen(envs.set_state(state)), kept)
    again = [seen(envs.step(action)[0]).copy() for action in actions]
    np.testing.assert_array_equal(again, first)
    moved = envs.set_state(state[1], [0])
    np.testing.assert_array_equal(seen(moved)[0], kept[1])
    np.testing.assert_array_equal(seen(moved)[1:], first[-1][1:])
    envs.close()


def test_a_state_that_is_written_is_drawn() -> None:
    envs = make_vec(Pixels(stack=2))
    envs.reset(seed=0)
    before = seen(envs.step(envs.action_space.sample())[0])
    envs.simulation.world.qpos[1, :3] += 0.3
    now = seen(envs.stack.measure()[""])
    np.testing.assert_array_equal(now[[0, 2]], before[[0, 2]])
    np.testing.assert_array_equal(now[1, :3], before[1, :3])
    assert (now[1, 3:] != before[1, 3:]).any()
    envs.close()


def test_memory_is_used_again_only_after_the_steps_that_were_promised() -> None:
    envs = make_vec(Pixels(valid_steps=2), autoreset=AutoresetMode.SAME_STEP, max_episode_steps=2)
    observation, _ = envs.reset(seed=0)
    places: list[int] = []
    history: list[tuple[Image, Image]] = []
    for _ in range(9):
        history.append((seen(observation), seen(observation).copy()))
        places.append(seen(observation).__array_interface__["data"][0])
        observation, *_ = envs.step(envs.action_space.sample())
        for shown, copied in history[-2:]:
            np.testing.assert_array_equal(shown, copied)
    assert len(set(places)) <= 5
    envs.close()
    fresh = make_vec()
    observations = [fresh.reset(seed=0)[0], *(fresh.step(fresh.action_space.sample())[0] for _ in range(3))]
    assert not any(np.shares_memory(seen(one), seen(two)) for one, two in itertools.pairwise(observations))
    with pytest.raises(ValueError, match="read-only"):
        seen(observations[0])[0, 0, 0, 0] = 1
    fresh.close()


def test_grey_is_the_luma_of_the_colours() -> None:
    colour, grey = make_vec(), make_vec(Pixels(grayscale=True))
    red, green, blue = np.moveaxis(seen(colour.reset(seed=0)[0]).astype(float), 1, 0)
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    np.testing.assert_allclose(seen(grey.reset(seed=0)[0])[:, 0], luma, atol=1.0)
    colour.close()
    grey.close()


@pytest.mark.gl
def test_full_quality_is_that_of_pictures_bit_for_bit() -> None:
    pixels, pictures = make_vec(render_quality="full"), make_vec(None, render_quality="full")
    shown, pictured = pixels.reset(seed=0)[0], pictures.reset(seed=0)[0]
    np.testing.assert_array_equal(np.moveaxis(seen(shown), 1, -1), pictured["frames"]["side"]["rgb"])
    pixels.close()
    pictures.close()


@pytest.mark.gl
@pytest.mark.parametrize(
    ("robot", "task", "camera"),
    [("fr3", "PickCuboid", "side"), ("so101", "Push", "wrist"), ("ur5e", "Place", "overhead")],
)
def test_pixels_look_like_pictures(robot: str, task: str, camera: str) -> None:
    options: dict[str, Any] = {"robot": robot, "task": task, "cameras": rcs.Cameras(names=(camera,), image_size=64)}
    pixels, pictures = make_vec(**options), make_vec(None, **options)
    shown, pictured = pixels.reset(seed=0)[0], pictures.reset(seed=0)[0]
    expected = pictured["frames"][camera]["rgb"]
    differences = np.abs(np.moveaxis(seen(shown, camera), 1, -1).astype(int) - expected)
    assert differences.mean() < 1.0
    assert (differences.max(axis=-1) > 24).mean() < 0.005  # edges
    assert np.ptp(expected.reshape(-1, 3), axis=0).min() > 60, "there is something to be seen"
    pixels.close()
    pictures.close()


def test_pixels_survive_json() -> None:
    setup = Setup(cameras=rcs.Cameras(names=("side",), pixels=Pixels(grayscale=True, stack=4, valid_steps=2)))
    assert Setup.from_json(setup.to_json()) == setup
    assert Setup(cameras=rcs.Cameras(pixels=True)).cameras.pixels == Pixels()
    assert Setup(cameras=rcs.Cameras(pixels=False)).cameras.pixels is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pixels": True, "depth": True}, "depth is True and pixels are given"),
        ({"pixels": True, "noise": True}, "noise is True"),
        ({"pixels": 3}, "pixels is 3; valid: an object of Pixels, or None"),
        ({"pixels": {"stacks": 2}}, "stack"),
    ],
)
def test_options_that_do_not_go_together_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidSetup, match=message):
        rcs.Cameras(**options)


@pytest.mark.parametrize("values", [{"stack": 0}, {"stack": True}, {"valid_steps": 0}, {"grayscale": 1}])
def test_a_field_that_is_not_valid_is_refused(values: dict[str, Any]) -> None:
    with pytest.raises(InvalidSetup, match=f"{next(iter(values))} is .*; valid"):
        Pixels(**values)
