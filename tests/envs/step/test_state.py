"""The whole state of an environment, got and set: the same actions lead to the same bits, wherever it is set."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import entry_points
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents import agent_for
from rcs.envs.setup import Setup
from rcs.envs.step.judge import row
from rcs.errors import InvalidSetup, WrongOrder
from rcs.sim.randomisation import Randomisation
from rcs.testing.env_contract import require_same_bits

TASKS = sorted(entry.name for entry in entry_points(group="rcs.tasks"))
LAB = {"LiftBar": "dual_fr3"}
OBSERVED = ("torques", "wrench", "contacts")


def setup_for(task: str, **options: Any) -> Setup:
    return Setup(task=task, robot=LAB.get(task, "fr3"), max_episode_steps=None, observe=OBSERVED, **options)


def drawn(env: Any, count: int, seed: int = 3) -> list[Any]:
    env.action_space.seed(seed)
    return [env.action_space.sample() for _ in range(count)]


def run(env: Any, actions: list[Any]) -> list[Any]:
    return [copy.deepcopy(env.step(action)) for action in actions]


@pytest.mark.parametrize("task", TASKS)
def test_every_task_goes_on_with_the_same_bits_in_another_environment(task: str) -> None:
    with_all = setup_for(task, randomisation=True)
    one, other = rcs.make(with_all), rcs.make(with_all)
    one.reset(seed=5)
    other.reset(seed=8)
    before, after = drawn(one, 4), drawn(one, 4, seed=4)
    run(one, before)
    run(other, after)
    state = pickle.loads(pickle.dumps(one.get_state()))
    expected = run(one, after)
    other.set_state(state)
    require_same_bits(run(other, after), expected)
    # The episode after it is that of the first environment, too.
    require_same_bits(other.reset(), one.reset())


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("copies", [None, 2])
def test_every_randomised_task_goes_back_to_its_start(task: str, copies: int | None) -> None:
    require_way_back(setup_for(task, randomisation=True), copies)


@pytest.mark.parametrize("randomisation", [False, True])
@pytest.mark.parametrize("robot", ["ur5e", "xarm7", "so101", "dual_fr3"])
def test_every_robot_goes_back_to_its_start(robot: str, randomisation: bool) -> None:
    require_way_back(replace(setup_for("Free", randomisation=randomisation), robot=robot))


def require_way_back(setup: Setup, copies: int | None = None) -> None:
    env = rcs.make(setup) if copies is None else rcs.make_vec(setup, copies=copies)
    env.reset(seed=5)
    actions = drawn(env, 3)
    state = env.get_state()
    expected = run(env, actions)
    env.set_state(state)
    require_same_bits(run(env, actions), expected)


@pytest.mark.parametrize("copies", [None, 2])
def test_a_state_from_before_the_first_load_has_none(copies: int | None) -> None:
    setup = setup_for("PickCuboid")
    env: Any = rcs.make(setup) if copies is None else rcs.make_vec(setup, copies=copies)
    env.reset(seed=5)
    actions = drawn(env, 3)
    before = env.get_state()
    unloaded = run(env, actions)
    robot = env.unwrapped.simulation.robots[0]
    robot.set_load(2.0)
    loaded_from = env.get_state()
    loaded = run(env, actions)
    env.set_state(before)
    require_same_bits(run(env, actions), unloaded)
    env.set_state(loaded_from)
    require_same_bits(run(env, actions), loaded)
    # Another environment, whose robot was never told of a load, takes it with the state.
    other: Any = rcs.make(setup) if copies is None else rcs.make_vec(setup, copies=copies)
    other.reset(seed=6)
    other.set_state(loaded_from)
    require_same_bits(run(other, actions), loaded)


@pytest.mark.parametrize("relative", ["absolute", "last_step", "origin"])
@pytest.mark.parametrize("control", ["joints", "tquat", "xyzrpy"])
@pytest.mark.parametrize("stepping", ["async", "sync"])
def test_every_control_goes_on_with_the_same_bits(control: Any, relative: Any, stepping: Any) -> None:
    require_continuation(control, relative, stepping)


@pytest.mark.parametrize("stepping", ["async", "sync"])
def test_control_by_velocities_goes_on_with_the_same_bits(stepping: Any) -> None:
    require_continuation("twist", "last_step", stepping)


def require_continuation(control: Any, relative: Any, stepping: Any) -> None:
    env = rcs.make(setup_for("PickCuboid", control=control, relative=relative, stepping=stepping))
    env.reset(seed=1)
    actions = near(env, 3)
    run(env, actions)
    state = env.get_state()
    expected = run(env, actions)
    first = env.set_state(state)
    require_same_bits(env.set_state(state), first)
    require_same_bits(run(env, actions), expected)


def near(env: Any, count: int) -> list[Any]:
    """Return actions that move the arm a little."""
    observation, _ = env.reset(seed=1)
    random = np.random.default_rng(0)
    actions: list[Any] = []
    for _ in range(count):
        action = env.action_space.sample()
        key = env.setup.control
        here = observation[key] if env.setup.relative == "absolute" else np.zeros(action[key].shape)
        change = random.uniform(-0.01, 0.01, action[key].shape)
        change[3:] *= key == "joints"
        action[key] = here + change
        if key == "tquat" and env.setup.relative != "absolute":
            action[key][6] = 1.0
        actions.append(action)
    return actions


def test_the_observation_of_a_state_is_the_one_that_was_seen_in_it() -> None:
    env = rcs.make(setup_for("PickCuboid"))
    env.reset(seed=1)
    seen = run(env, drawn(env, 5))[-1][0]
    state = env.get_state()
    run(env, drawn(env, 5))
    require_same_bits(env.set_state(state), seen)


def test_a_hold_that_was_begun_goes_on() -> None:
    env = rcs.make("PickCuboid", max_episode_steps=None)
    expert = agent_for(env)
    observation, info = env.reset(seed=0)
    expert.reset(observation, info)
    actions: list[Any] = []
    is_over = False
    states = []
    while not is_over:
        states.append(env.get_state())
        actions.append(expert.act(observation, info))
        observation, _, is_over, _, info = env.step(actions[-1])
    middle = len(actions) - 10  # the cuboid is held, and not for long enough
    env.set_state(states[middle])
    ends = [terminated for _, _, terminated, _, _ in run(env, actions[middle:])]
    assert ends == [False] * 9 + [True]


def require_exchange(batch: rcs.VecEnv, single: rcs.Env) -> None:
    """Take the state of a copy to a single environment, and that of the single one to another copy: both go on."""
    batch.reset(seed=7)
    single.reset(seed=70)
    run(batch, drawn(batch, 4))
    actions = drawn(single, 6)
    run(single, actions)
    own, of_copy = single.get_state(), batch.get_state([1])
    batch.set_state(own, [2])
    expected_own = run(single, actions)
    single.set_state(of_copy)
    expected_copy = run(single, actions)
    together = [_three(action) for action in actions]
    for step, mine, theirs in zip(run(batch, together), expected_own, expected_copy, strict=True):
        require_same_bits(of(step, 2), of_single(mine))
        require_same_bits(of(step, 1), of_single(theirs))


@pytest.mark.parametrize("threads", [1, 2])
def test_copies_and_single_environments_go_on_from_each_others_states(threads: int) -> None:
    setup = setup_for("PickCuboid", randomisation=True)
    batch, single = rcs.make_vec(setup, copies=3, threads=threads), rcs.make(setup)
    require_exchange(batch, single)


def test_a_state_of_one_copy_is_set_in_all_and_the_others_stay() -> None:
    batch = rcs.make_vec(setup_for("PickCuboid"), copies=3)
    batch.reset(seed=7)
    actions = drawn(batch, 2)
    run(batch, actions)
    all_of_them = batch.get_state()
    batch.set_state(all_of_them[1], [0, 2])
    same = [_three(row(action, 0)) for action in actions]
    for observation, *_ in run(batch, same):
        for copies in (0, 2):
            require_same_bits(row(observation, copies), row(observation, 1))
    batch.set_state(all_of_them[[2, 1]], [2, 1])
    batch.set_state(all_of_them[0], [0])
    first = run(batch, actions)
    batch.set_state(all_of_them)
    require_same_bits(run(batch, actions), first)


def test_an_episode_that_is_over_is_over_in_its_state() -> None:
    env = rcs.make("Free", max_episode_steps=2)
    env.reset(seed=0)
    actions = drawn(env, 2)
    env.step(actions[0])
    state = env.get_state()
    assert env.step(actions[1])[3]
    over = env.get_state()
    env.set_state(state)
    assert env.step(actions[1])[3]
    env.reset()
    env.set_state(over)
    with pytest.raises(WrongOrder, match="call reset"):
        env.step(actions[0])


def test_a_hold_before_the_state_was_read_counts() -> None:
    env = rcs.make("Free", relative=True, max_episode_steps=None)
    env.reset(seed=0)
    actions = drawn(env, 6)
    run(env, actions[:4])
    env.hold()
    state = env.get_state()
    expected = run(env, actions)
    env.set_state(state)
    require_same_bits(run(env, actions), expected)


CAMERAS = rcs.Cameras(names=("side", "wrist"), fps={"side": 6.0}, image_size=(32, 24))


@pytest.mark.gl
@pytest.mark.parametrize("ranges", [None, Randomisation.off(frame_latency=(0.07, 0.07))], ids=["at once", "late"])
@pytest.mark.parametrize("stepping", ["async", "sync"])
def test_frames_that_are_shown_again_are_part_of_a_state(stepping: Any, ranges: Randomisation | None) -> None:
    setup = Setup(task="PickCuboid", cameras=CAMERAS, randomisation=ranges, stepping=stepping)
    one, other = rcs.make(setup), rcs.make(setup)
    one.reset(seed=0)
    other.reset(seed=1)
    actions = drawn(one, 8)
    seen = run(one, actions[:3])[-1][0]
    run(other, actions[3:])
    state = pickle.loads(pickle.dumps(one.get_state()))
    expected = run(one, actions)
    require_same_bits(other.set_state(state), seen)
    require_same_bits(run(other, actions), expected)


@pytest.mark.gl
@pytest.mark.parametrize("pixels", [None, rcs.Pixels(stack=2)], ids=["frames", "pixels"])
def test_copies_and_single_environments_go_on_with_each_others_late_frames(pixels: rcs.Pixels | None) -> None:
    ranges = Randomisation.off(frame_latency=(0.0, 0.1), frame_jitter=0.03)
    setup = Setup(task="PickCuboid", cameras=replace(CAMERAS, pixels=pixels), randomisation=ranges)
    batch, single = rcs.make_vec(setup, copies=3), rcs.make(setup)
    require_exchange(batch, single)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"task": "Free"}, "its task is PickCuboid; here Free"),
        ({"frequency": 50.0}, "its frequency is 30.0; here 50.0"),
        ({"control": "tquat"}, "its layers"),
        ({"robot": "ur5e"}, "its robots"),
        ({"observe": ()}, "its size of the simulation's state"),
        ({"end_effector": "robotiq_2f85"}, "its scene"),
    ],
)
def test_a_state_of_another_environment_is_refused(options: Mapping[str, Any], words: str) -> None:
    env = rcs.make(setup_for("PickCuboid"))
    other = rcs.make(replace(setup_for("PickCuboid"), **options))
    env.reset(seed=0)
    other.reset(seed=0)
    with pytest.raises(InvalidSetup, match=words):
        other.set_state(env.get_state())


def test_what_is_no_state_and_what_is_no_copy_is_refused() -> None:
    batch = rcs.make_vec("Free", copies=3)
    batch.reset(seed=0)
    state: Any = batch.get_state([0, 1])
    with pytest.raises(InvalidSetup, match="of 2 copies"):
        batch.set_state(state)
    with pytest.raises(InvalidSetup, match="get_state returned"):
        batch.set_state(state.world)
    for copies in ([], [3], [-1], [0, 0], [0.5], [[0]]):
        with pytest.raises(InvalidSetup, match="copies is"):
            batch.get_state(copies)  # pyright: ignore[reportArgumentType]


def test_before_the_first_reset_there_is_no_state() -> None:
    with pytest.raises(WrongOrder, match="call reset"):
        rcs.make("Free").get_state()


def test_real_devices_have_no_state(make_bench: Any) -> None:
    env = make_bench().env
    env.reset()
    with pytest.raises(WrongOrder, match="real devices"):
        env.get_state()


def of(step: Any, index: int) -> Any:
    """Return a step of one copy of a batch, without the masks of its info."""
    observation, reward, terminated, truncated, info = step
    target = {key: value for key, value in info["target"].items() if not key.startswith("_")}
    return row(observation, index), reward[index], terminated[index], truncated[index], row(target, index)


def of_single(step: Any) -> Any:
    observation, reward, terminated, truncated, info = step
    return observation, np.float64(reward), np.bool_(terminated), np.bool_(truncated), info["target"]


def _three(action: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: _three(value) if isinstance(value, Mapping) else np.repeat(value[None], 3, axis=0)
        for key, value in action.items()
    }
