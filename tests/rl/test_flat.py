from __future__ import annotations

import functools
import json
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import rcs
from rcs.agents import agent_for
from rcs.envs.env import Env
from rcs.envs.vector import VecEnv
from rcs.errors import InvalidAction, InvalidSetup
from rcs.rl import Flat, FlatEnv, FlatLayout

SETUPS: dict[str, dict[str, Any]] = {
    "joints": {"observe": ("privileged", "contacts", "torques", "wrench")},
    "xyzrpy": {"task": "Place", "robot": "ur5e", "control": "xyzrpy", "observe": ("privileged",)},
    "two arms": {"task": "LiftBar", "robot": "dual_fr3", "observe": ("privileged", "contacts")},
    "a hand": {"task": "PickToy", "robot": "xarm7", "observe": ("privileged", "contacts")},
    "poses": {"robot": "so101", "control": "tquat", "observe": ("privileged",)},
    "a target": {
        "control": "xyzrpy",
        "layers": ("rcs.envs.layers:ObserveTarget", "rcs.envs.layers:KeepTilt"),
        "observe": ("privileged",),
    },
    "velocities": {"control": "twist", "observe": ("privileged",)},
    "nothing privileged": {"control": "joints", "relative": "absolute", "binary_gripper": False},
}
KINDS = pytest.mark.parametrize("kind", list(SETUPS))


@functools.cache
def made(kind: str) -> tuple[Env, Flat]:
    env = rcs.make(**SETUPS[kind])
    return env, Flat(env)


@functools.cache
def rolled_out(kind: str) -> list[dict[str, Any]]:
    """Observations of a few steps with random actions."""
    env, flat = made(kind)
    observations = [env.reset(seed=3)[0]]
    random = np.random.default_rng(0)
    for _ in range(6):
        vector = random.uniform(-1, 1, flat.action_space.shape)
        observations.append(env.step(flat.action(vector))[0])
    return observations


def leaves(values: Any, path: str = "") -> dict[str, NDArray[Any]]:
    if not isinstance(values, Mapping):
        return {path: values}
    return {name: leaf for key, one in values.items() for name, leaf in leaves(one, f"{path}/{key}").items()}


def same_bits(a: Any, b: Any) -> bool:
    one, other = leaves(a), leaves(b)
    return one.keys() == other.keys() and all(
        one[key].dtype == other[key].dtype and np.array_equal(one[key], other[key]) for key in one
    )


@KINDS
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_a_vector_of_an_action_comes_back_from_the_action(kind: str, seed: int) -> None:
    env, flat = made(kind)
    vector = np.random.default_rng(seed).uniform(-1, 1, flat.action_space.shape).astype(np.float32)
    action = flat.action(vector)
    np.testing.assert_allclose(flat.action_vector(action), vector, rtol=0, atol=1e-6)
    assert leaves(action).keys() == leaves(env.action_space.sample()).keys()


@KINDS
def test_the_corners_of_the_box_are_the_bounds_of_every_action(kind: str) -> None:
    env, flat = made(kind)
    boxes = leaves(spaces_of(env.action_space))
    for corner, name in ((-1.0, "low"), (1.0, "high")):
        for key, value in leaves(flat.action(np.full(flat.action_space.shape, corner))).items():
            np.testing.assert_allclose(value, getattr(boxes[key], name), rtol=0, atol=1e-6)


def spaces_of(space: spaces.Space[Any]) -> dict[str, Any]:
    assert isinstance(space, spaces.Dict)
    return {key: spaces_of(one) if isinstance(one, spaces.Dict) else one for key, one in space.spaces.items()}


def test_actions_beyond_the_box_count_as_its_border_and_others_without_a_value_are_refused() -> None:
    _, flat = made("joints")
    vector = np.linspace(-3, 3, 8, dtype=np.float32)
    assert same_bits(flat.action(vector), flat.action(np.clip(vector, -1, 1)))
    for bad in (np.nan, np.inf):
        with pytest.raises(InvalidAction, match=r"number \[1, 2\] is (nan|inf); valid is -1 to 1"):
            flat.action(np.where(np.arange(16).reshape(2, 8) == 10, bad, 0.0))
    with pytest.raises(InvalidAction, match=r"shape \(7,\); valid is \(\.\.\., 8\)"):
        flat.action(np.zeros(7))


@KINDS
def test_a_batch_of_any_shape_has_the_bits_of_single_ones(kind: str) -> None:
    _, flat = made(kind)
    observations = rolled_out(kind)[:6]

    def stacked(values: list[Any], shape: tuple[int, ...]) -> Any:
        if isinstance(values[0], Mapping):
            return {key: stacked([one[key] for one in values], shape) for key in values[0]}
        return np.stack(values).reshape(*shape, *values[0].shape)

    singles = np.stack([flat.observation(one) for one in observations])
    for shape in ((6,), (2, 3), (6, 1)):
        batch = stacked(observations, shape)
        np.testing.assert_array_equal(flat.observation(batch), singles.reshape(*shape, -1))
    vectors = np.random.default_rng(1).uniform(-1.2, 1.2, (6, *flat.action_space.shape))
    assert same_bits(flat.action(vectors), stacked([flat.action(one) for one in vectors], (6,)))
    batch = flat.action(vectors)
    np.testing.assert_array_equal(flat.action_vector(batch)[3], flat.action_vector(flat.action(vectors[3])))


@KINDS
def test_a_layout_survives_json_and_is_all_that_the_maps_need(kind: str) -> None:
    _, flat = made(kind)
    layout = FlatLayout.from_json(json.loads(json.dumps(flat.layout.to_json(), allow_nan=False)))
    assert layout == flat.layout
    stored = Flat(layout)
    assert (stored.action_space, stored.observation_space) == (flat.action_space, flat.observation_space)
    for observation in rolled_out(kind):
        vector = flat.observation(observation)
        np.testing.assert_array_equal(stored.observation(observation), vector)
    vector = flat.action_space.sample()
    assert same_bits(stored.action(vector), flat.action(vector))


@KINDS
def test_many_copies_have_the_layout_of_one_environment(kind: str) -> None:
    envs = rcs.make_vec(copies=2, **SETUPS[kind])
    assert Flat(envs).layout == made(kind)[1].layout
    envs.close()


def test_arguments_stay_as_they_are() -> None:
    _, flat = made("two arms")
    observation = rolled_out("two arms")[2]
    copy = {key: np.array(value) for key, value in leaves(observation).items()}
    flat.observation(observation)
    assert same_bits(leaves(observation), copy)
    action = flat.action(np.zeros(flat.action_space.shape))
    copy = {key: np.array(value) for key, value in leaves(action).items()}
    flat.action_vector(action)
    assert same_bits(leaves(action), copy)


def entry(flat: Flat, name: str, kind: str) -> slice:
    first = 0
    for one in flat.layout.state:
        if (one.name, one.kind) == (name, kind):
            return slice(first, first + one.size)
        first += one.size
    raise KeyError(name)


@KINDS
def test_values_are_offset_and_scaled_and_rotations_are_columns_of_their_matrix(kind: str) -> None:
    _, flat = made(kind)
    for observation in rolled_out(kind):
        vector, values = flat.observation(observation), leaves(observation)
        for one in flat.layout.state:
            if one.to:
                continue
            value = values[f"/{one.key}"].ravel()
            expected = (value[: one.size] - one.offset) / one.scale
            if one.kind == "turn":
                expected = rcs.Pose(value[:3], value[3:]).matrix[:3, :2].T.ravel()
            np.testing.assert_allclose(vector[entry(flat, one.name, one.kind)], expected, atol=1e-6)


def test_offsets_and_relative_turns_are_those_of_the_poses() -> None:
    _, flat = made("xyzrpy")
    for observation in rolled_out("xyzrpy"):
        vector = flat.observation(observation)
        poses = {"tquat": observation["tquat"]}
        poses |= {f"privileged/{name}/tquat": one["tquat"] for name, one in observation["privileged"].items()}
        for here, there in (
            ("tquat", "privileged/cuboid/tquat"),
            ("tquat", "privileged/mark/tquat"),
            ("privileged/cuboid/tquat", "privileged/mark/tquat"),
        ):
            first, second = (rcs.Pose(one[:3], one[3:]) for one in (poses[here], poses[there]))
            offset = vector[entry(flat, f"{here} to {there}", "offset")]
            np.testing.assert_allclose(0.1 * offset, second.translation - first.translation, atol=1e-6)
            turn = vector[entry(flat, f"{here} to {there}", "relative_turn")]
            expected = (first.inverse() * second).matrix[:3, :2].T.ravel()
            np.testing.assert_allclose(turn, expected, atol=1e-6)
            near, way = vector[entry(flat, f"{here} to {there}", "near")], second.translation - first.translation
            np.testing.assert_allclose(near, way / np.sqrt(way**2 + 0.03**2), atol=1e-6)


def test_a_box_turned_by_half_a_turn_looks_the_same_to_a_gripper() -> None:
    _, flat = made("joints")
    observation = rolled_out("joints")[3]
    half = entry(flat, "tquat to privileged/cuboid/tquat", "half_turn")

    def seen(yaw: float) -> NDArray[Any]:
        turned = {**observation["privileged"]["cuboid"]}
        turned["tquat"] = np.array([0.5, 0.1, 0.03, 0, 0, np.sin(yaw / 2), np.cos(yaw / 2)])
        straight_down = np.array([0.5, 0, 0.2, 1, 0, 0, 0])
        return flat.state({**observation, "tquat": straight_down, "privileged": {"cuboid": turned}})[half]

    for yaw in np.linspace(-3, 3, 7):
        np.testing.assert_allclose(seen(yaw), [np.cos(2 * yaw), -np.sin(2 * yaw)], atol=1e-6)  # seen from above
        np.testing.assert_allclose(seen(yaw), seen(yaw + np.pi), atol=1e-6)


def test_offsets_of_two_arms_are_from_where_their_bases_stand() -> None:
    env, flat = made("two arms")
    for observation in rolled_out("two arms"):
        vector = flat.observation(observation)
        bar = observation["privileged"]["bar"]["tquat"]
        for name, placement in env.robots.items():
            mount, tcp = placement.base_in_scene, observation[name]["tquat"]
            in_scene = rcs.Pose(mount.translation, mount.quaternion) * rcs.Pose(tcp[:3], tcp[3:])
            offset = vector[entry(flat, f"{name}/tquat to privileged/bar/tquat", "offset")]
            np.testing.assert_allclose(0.1 * offset, bar[:3] - in_scene.translation, atol=1e-6)


@pytest.mark.parametrize("kind", ["joints", "xyzrpy", "two arms"])
def test_what_an_expert_sees_is_about_1_in_size(kind: str) -> None:
    env, flat = made(kind)
    agent = agent_for(env)
    observation, info = env.reset(seed=1)
    agent.reset(observation, info)
    seen: list[NDArray[Any]] = []
    for _ in range(150):
        seen.append(flat.observation(observation))
        observation, _, terminated, truncated, info = env.step(agent.act(observation, info))
        if terminated or truncated:
            break
    sizes = np.abs(np.stack(seen))
    assert np.mean(sizes <= 1.0) > 0.8
    assert np.quantile(sizes, 0.99) < 6.0


def test_observations_that_do_not_fit_are_refused() -> None:
    _, flat = made("joints")
    observation = rolled_out("joints")[0]
    with pytest.raises(InvalidSetup, match="'gripper' is missing; given: joints"):
        flat.observation({"joints": observation["joints"], "finger_contacts": observation["finger_contacts"]})
    with pytest.raises(InvalidSetup, match=r"'joints' has shape \(6,\); valid is \(\.\.\., 7\)"):
        flat.observation({**observation, "joints": np.zeros(6)})
    with pytest.raises(InvalidSetup, match=r"'joints' has shape \(4, 7\), unlike the keys before it"):
        flat.observation({**observation, "joints": np.zeros((4, 7))})


def test_a_wrapper_makes_actions_and_observations_vectors() -> None:
    env = rcs.make(max_episode_steps=5, observe=("privileged",))
    wrapped, flat = FlatEnv(gymnasium.wrappers.TimeLimit(env, 4)), Flat(env)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="(?s).*is different from the unwrapped version")
        check_env(wrapped, skip_render_check=True)
    assert wrapped.flat.layout == flat.layout
    start, info = wrapped.reset(seed=3)
    expected, its_info = env.reset(seed=3)
    np.testing.assert_array_equal(start, flat.observation(expected))
    assert info.keys() == its_info.keys()
    observation, *_ = wrapped.step(flat.action_space.sample())
    assert wrapped.observation_space.contains(observation)
    env.close()


@pytest.mark.gl
@pytest.mark.parametrize("copies", [None, 2])
def test_frames_are_planes_of_uint8_beside_the_state(copies: int | None) -> None:
    options: dict[str, Any] = {"cameras": rcs.Cameras(names=("wrist", "side"), image_size=(48, 40))}
    env: Env | VecEnv = rcs.make(**options) if copies is None else rcs.make_vec(copies=copies, **options)
    flat = Flat(env)
    assert isinstance(flat.observation_space, spaces.Dict)
    assert {key: one.shape for key, one in flat.observation_space.spaces.items()} == {
        "state": (flat.layout.state_size,),
        "wrist": (3, 40, 48),
        "side": (3, 40, 48),
    }
    observation, _ = env.reset(seed=0)
    vectors = flat.observation(observation)
    for name in ("wrist", "side"):
        frame = observation["frames"][name]["rgb"]
        assert vectors[name].flags.c_contiguous
        np.testing.assert_array_equal(np.moveaxis(vectors[name], -3, -1), frame)
    if copies is None:
        assert flat.observation_space.contains(vectors)
    stored = Flat(FlatLayout.from_json(json.loads(json.dumps(flat.layout.to_json()))))
    assert same_bits(stored.observation(observation), vectors)
    env.close()


def test_a_real_robot_has_the_layout_of_the_simulated_one() -> None:
    simulated, real = rcs.make("Free"), rcs.make("Free", hardware="fake")
    assert Flat(simulated).layout == Flat(real).layout
    tilted, same = rcs.make("Free", robot="ur5e"), rcs.make("Free", robot="ur5e", hardware="fake")
    assert Flat(tilted).layout == Flat(same).layout != Flat(real).layout


def test_the_maps_need_no_torch(run_program: Callable[..., Any]) -> None:
    done = run_program("import sys, rcs; rcs.rl.Flat; print('torch' in sys.modules)")
    assert done.stdout.strip() == "False", done.stderr


@pytest.mark.parametrize("pixels", [rcs.Pixels(), rcs.Pixels(grayscale=True, stack=2)])
def test_pixels_that_are_planes_already_stay_as_they_are(pixels: rcs.Pixels) -> None:
    envs = rcs.make_vec(
        "PickCuboid", copies=2, cameras=rcs.Cameras(names=("side",), image_size=(16, 12), pixels=pixels)
    )
    flat = Flat(envs)
    observation, _ = envs.reset(seed=0)
    seen = observation["frames"]["side"]["pixels"]
    assert np.shares_memory(flat.observation(observation)["side"], seen)
    assert flat.observation_space["side"].shape == seen.shape[1:]
    envs.close()
