from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.errors import DeviceFault, InvalidAction, InvalidSetup, MissingDependency, WrongOrder
from rcs.testing.env_contract import require_same_bits
from tests.envs.notebook import Notebook


def test_without_a_seed_episodes_of_the_last_seed_go_on() -> None:
    env, other = rcs.make("PickCuboid"), rcs.make("PickCuboid")
    starts = [env.reset(seed=5)[1]["cuboid"], env.reset()[1]["cuboid"], env.reset()[1]["cuboid"]]
    again = [other.reset(seed=5)[1]["cuboid"], other.reset()[1]["cuboid"], other.reset()[1]["cuboid"]]
    np.testing.assert_array_equal(starts, again)
    assert len(np.unique(starts, axis=0)) == 3


def test_without_any_seed_two_environments_differ() -> None:
    cuboids = [rcs.make("PickCuboid").reset()[1]["cuboid"] for _ in range(3)]
    assert len(np.unique(cuboids, axis=0)) == 3


@pytest.mark.parametrize("seed", [2**63, 2**70, -1, 1.0, "1", True, [1]])
def test_a_seed_that_is_no_whole_number_in_range_is_refused(seed: Any) -> None:
    with pytest.raises(InvalidSetup, match="seed"):
        rcs.make("Free").reset(seed=seed)


def test_a_seed_may_be_an_integer_of_numpy() -> None:
    env = rcs.make("PickCuboid")
    require_same_bits(env.reset(seed=np.int64(3))[0], env.reset(seed=3)[0])  # type: ignore[arg-type]


@pytest.mark.parametrize("options", [5, "state", [("state", 0)]])
def test_reset_options_that_are_no_dictionary_are_refused(options: Any) -> None:
    for env in (rcs.make("Free"), rcs.make_vec("Free")):
        with pytest.raises(InvalidSetup, match="options"):
            env.reset(seed=0, options=options)


@pytest.mark.parametrize("value", [1e300, -1e11, np.inf, np.nan, "text", None])
def test_a_state_beyond_all_that_can_be_simulated_is_refused(value: Any) -> None:
    env = rcs.make("Free")
    env.reset(seed=0)
    state = env.simulation.world.states().astype(object)
    state[3] = value
    with pytest.raises(InvalidSetup, match="'state'"):
        env.reset(options={"state": state})
    env.step(env.action_space.sample())


def test_an_action_with_masked_values_is_refused() -> None:
    env = rcs.make("Free")
    env.reset(seed=0)
    action = env.action_space.sample()
    action["joints"] = np.ma.masked_array(action["joints"], mask=[True, *[False] * 6])
    with pytest.raises(InvalidAction, match="mask"):
        env.step(action)


@pytest.mark.parametrize("option", ["state", "robot", "objects"])
def test_reset_options_with_masked_values_are_refused(option: str) -> None:
    env = rcs.make("PickCuboid")
    observation, _ = env.reset(seed=0)
    state = env.simulation.world.states()
    given: dict[str, Any] = {
        "state": np.ma.masked_greater(state, -np.inf),
        "robot": {"joints": np.ma.masked_greater(observation["joints"], -np.inf)},
        "objects": {"cuboid": np.ma.masked_greater(env.simulation.object_poses()["cuboid"], -np.inf)},
    }
    with pytest.raises(InvalidSetup, match="masked"):
        env.reset(options={option: given[option]})


def test_a_device_that_is_in_fault_is_told_at_reset(make_bench) -> None:
    bench = make_bench()
    bench.env.reset(seed=0)
    bench.arm.set_fault("touched something")
    with pytest.raises(DeviceFault, match=r"touched something.*env\.recover"):
        bench.env.reset()
    bench.env.recover()
    bench.env.reset()


def test_info_says_what_a_target_came_to() -> None:
    env = rcs.make("Free")
    observation, _ = env.reset(seed=0)
    action = {"joints": np.full(7, 0.02), "gripper": np.zeros(1, np.float32)}
    *_, info = env.step(action)
    np.testing.assert_array_equal(info["target"]["joints"], env.stack.executed["joints"])
    np.testing.assert_allclose(info["target"]["joints"], observation["joints"] + 0.02)
    info["target"]["joints"][:] = 9.0  # it is the caller's own
    *_, info = env.step(action)
    np.testing.assert_allclose(info["target"]["joints"], observation["joints"] + 0.04)


def test_the_same_seed_gives_the_same_bits_in_another_process() -> None:
    program = """
import hashlib, rcs
env = rcs.make("PickCuboid", control="xyzrpy")
env.action_space.seed(4)
observation, info = env.reset(seed=4)
digest = hashlib.sha256()
for _ in range(5):
    observation, reward, *_ = env.step(env.action_space.sample())
    for key in sorted(observation):
        digest.update(observation[key].tobytes())
    digest.update(repr(reward).encode())
print(digest.hexdigest())
"""
    answers = {
        subprocess.run(
            [sys.executable, "-c", program],
            capture_output=True,
            text=True,
            check=True,
            timeout=60,
            env={**os.environ, "PYTHONHASHSEED": seed},
        ).stdout
        for seed in ("1", "2")
    }
    assert len(answers) == 1


def test_an_episode_can_start_in_a_state() -> None:
    env = rcs.make("PickCuboid")
    env.reset(seed=1)
    action = env.action_space.sample()
    for _ in range(3):
        env.step(action)
    state = env.simulation.world.states()
    observation, info = env.reset(seed=9, options={"state": state})
    np.testing.assert_array_equal(env.simulation.world.states(), state)
    np.testing.assert_array_equal(observation["joints"], env.simulation.robots[0].joints)
    assert not np.array_equal(info["cuboid"], env.reset(seed=9)[1]["cuboid"])


@pytest.mark.parametrize("options", [{"state": np.zeros(3)}, {"state": np.nan}, {"no_such_option": 1}])
def test_wrong_reset_options_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(InvalidSetup):
        rcs.make("Free").reset(seed=0, options=options)


def test_a_simulation_that_diverges_ends_the_episode_and_reset_starts_anew(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log there
    env = rcs.make("Free")
    expected, _ = env.reset(seed=0)
    env.simulation.world.qvel[0] = np.nan
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    assert (reward, terminated, truncated, info["end"]) == (0.0, False, True, "diverged")
    assert "huge value in QVEL at DOF 0" in info["faults"]["simulation"]
    assert "the observation is the last good one" in info["faults"]["simulation"]
    require_same_bits(observation, expected)
    assert env.observation_space.contains(observation)
    with pytest.raises(WrongOrder):
        env.step(env.action_space.sample())
    observation, _ = env.reset(seed=0)
    require_same_bits(observation, expected)
    env.step(env.action_space.sample())


def test_info_says_why_a_step_ended() -> None:
    env = rcs.make("Free")
    env.reset(seed=0)
    assert env.step(env.action_space.sample())[-1]["end"] == "period"
    sync = rcs.make("Free", stepping="sync", relative=False)
    observation, _ = sync.reset(seed=0)
    action = {"joints": observation["joints"] + 0.05, "gripper": np.ones(1, np.float32)}
    observation, *_, info = sync.step(action)
    assert info["end"] == "converged"
    np.testing.assert_allclose(observation["joints"], action["joints"], atol=2e-3)


def test_a_synchronous_step_of_the_gripper_alone_waits_for_the_fingers() -> None:
    env = rcs.make("Free", stepping="sync", relative=False)
    observation, _ = env.reset(seed=0)
    for opening in (0.0, 1.0):
        action = {"joints": observation["joints"], "gripper": np.full(1, opening, np.float32)}
        observation, *_, info = env.step(action)
        assert info["end"] == "converged"
        assert observation["gripper"][0] == pytest.approx(opening, abs=0.05)


def test_an_episode_is_truncated_after_its_steps_and_not_before() -> None:
    env = rcs.make("Free", max_episode_steps=3)
    env.reset(seed=0)
    assert [env.step(env.action_space.sample())[3] for _ in range(3)] == [False, False, True]
    endless = rcs.make("Free", max_episode_steps=None)
    endless.reset(seed=0)
    assert not any(endless.step(endless.action_space.sample())[3] for _ in range(10))


def test_an_observer_sees_every_transition() -> None:
    env, notebook = rcs.make("Free", relative=False), Notebook()
    env.add_observer(notebook)
    observation, _ = env.reset(seed=3)
    action = {"joints": observation["joints"] + 2.0, "gripper": np.zeros(1, np.float32)}
    action["joints"] = np.clip(action["joints"], env.action_space["joints"].low, env.action_space["joints"].high)
    after, *_ = env.step(action)
    first, second = notebook.seen
    assert notebook.seeds == [3]
    assert first.action is None
    assert first.executed is None
    require_same_bits((first.observation, second.observation), (observation, after))
    np.testing.assert_array_equal(second.action["joints"], action["joints"])
    # The target was cut to what an arm can do in one period: what was executed is not what was asked.
    assert np.abs(second.executed["joints"] - observation["joints"]).max() < 0.2
    assert second.time >= first.time
    env.close()
    env.close()
    assert notebook.closed == 1


def test_render_gives_nothing_unless_asked_for() -> None:
    env = rcs.make("Free")
    env.reset(seed=0)
    assert env.render() is None
    with pytest.raises(InvalidSetup, match="render_mode"):
        rcs.make("Free", render_mode="ansi")


def test_a_window_needs_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(MissingDependency, match="display"):
        rcs.make("Free", render_mode="human").reset(seed=0)


@pytest.mark.gl
def test_a_list_of_pictures_has_one_for_each_step() -> None:
    env = rcs.make("Free", render_mode="rgb_array_list")
    env.reset(seed=0)
    for _ in range(3):
        env.step(env.action_space.sample())
    assert [picture.shape for picture in env.render()] == [(480, 640, 3)] * 4
    assert env.render() == []
    env.close()


@pytest.mark.gl
def test_render_gives_a_picture() -> None:
    env = rcs.make("Free", render_mode="rgb_array")
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (480, 640, 3)
    assert picture.std() > 10
    env.close()


def test_a_printed_environment_shows_its_stack_from_top_to_bottom() -> None:
    lines = str(rcs.make("PickCuboid", control="xyzrpy", relative=False)).splitlines()
    parts = ["rcs PickCuboid with fr3", "500 Hz", "BinaryGripper", "XyzrpyControl", "CartesianControl"]
    parts += ["LimitStep", "SimArmPort: joints -> joints, tquat", "SimEffectorPort: gripper -> gripper"]
    assert len(lines) == len(parts)
    for line, part in zip(lines, parts, strict=True):
        assert part in line


def test_an_environment_on_devices_moves_them(make_bench) -> None:
    bench = make_bench()
    assert not bench.arm.is_open
    observation, info = bench.env.reset(seed=0)
    assert bench.arm.is_open
    assert info == {"time": 100.0, "instruction": ""}
    action = {"joints": np.full(7, 0.03), "gripper": np.zeros(1, np.float32)}
    start = observation["joints"]
    for _ in range(10):
        observation, reward, terminated, truncated, info = bench.env.step(action)
    np.testing.assert_allclose(observation["joints"], start + 0.3, atol=1e-9)
    assert observation["gripper"][0] < 0.5
    assert (reward, terminated, truncated) == (0.0, False, False)
    assert bench.clock.now == pytest.approx(100.0 + 10 / 30)
    bench.env.hold()
    bench.env.close()
    bench.env.hold()
    assert not bench.arm.is_open
    with pytest.raises(WrongOrder, match="no simulated world"):
        _ = bench.env.simulation


def test_a_device_in_fault_stops_all_others(make_bench) -> None:
    bench = make_bench()
    observation, _ = bench.env.reset(seed=0)
    action = {"joints": np.full(7, 0.03), "gripper": np.zeros(1, np.float32)}
    bench.env.step(action)
    bench.gripper.set_fault("the fingers are blocked")
    _, _, terminated, truncated, info = bench.env.step(action)
    assert (terminated, truncated, info["end"]) == (False, True, "fault")
    assert info["faults"] == {"fake gripper": "the fingers are blocked"}
    before = bench.arm.state().joints
    bench.clock.sleep(1.0)
    np.testing.assert_array_equal(bench.arm.state().joints, before)


def test_an_interrupted_step_stops_the_robot(make_bench) -> None:
    bench = make_bench()
    bench.env.reset(seed=0)

    def interrupt(seconds: float) -> None:
        bench.clock.now += seconds / 4
        raise KeyboardInterrupt

    bench.env.clock._sleep = interrupt
    with pytest.raises(KeyboardInterrupt):
        bench.env.step({"joints": np.full(7, 0.03), "gripper": np.zeros(1, np.float32)})
    before = bench.arm.state().joints
    bench.clock.now += 1.0
    np.testing.assert_array_equal(bench.arm.state().joints, before)


def test_every_device_is_closed_also_when_one_fails_to(make_bench) -> None:
    bench = make_bench()
    bench.env.reset(seed=0)

    bench.env.stack.ports[0].close = _fail
    with pytest.raises(OSError, match="no answer"):
        bench.env.close()
    assert not bench.gripper.is_open
    bench.env.close()


def _fail() -> None:
    raise OSError("no answer")


def test_an_attribute_of_other_libraries_names_the_place_here() -> None:
    with rcs.make("Free") as env:
        for name, place in (("model", "env.simulation.world.model"), ("task", "env.simulation.task"), ("sim", "world")):
            with pytest.raises(AttributeError, match=place):
                getattr(env, name)
        assert not hasattr(env, "anything")


def test_a_gripper_takes_a_plain_number() -> None:
    with rcs.make("Free") as env:
        env.reset(seed=0)
        observation, *_ = env.step({"joints": [0.0] * 7, "gripper": 1.0})
        assert env.observation_space.contains(observation)
