"""Whatever goes wrong, nothing moves on: on every id, on one robot and two, on simulated devices and on fakes."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import pytest

import rcs
from rcs.envs.env import Env
from rcs.envs.layers import Layer
from rcs.errors import DeviceFault, UnknownName, WrongOrder
from rcs.setups.ids import ids
from tests.envs.acting import go, joints_of, lift, stay
from tests.envs.safety_contract import PUSH, SafetyContract

OPTIONS: dict[str, dict[str, Any]] = {
    **{name: {"task": task, "robot": robot} for name, (task, robot) in ids().items()},
    "absolute joints": {"task": "Free", "relative": False},
    "relative poses": {"task": "Free", "control": "tquat"},
    "absolute poses": {"task": "Free", "control": "tquat", "relative": False},
    "relative roll-pitch-yaw": {"task": "Free", "control": "xyzrpy"},
    "absolute roll-pitch-yaw": {"task": "Free", "control": "xyzrpy", "relative": False},
    "velocities": {"task": "Free", "control": "twist"},
    "joints relative to an origin": {"task": "Free", "relative": "origin"},
    "poses relative to an origin": {"task": "Free", "control": "tquat", "relative": "origin"},
    "two robots by relative poses": {"task": "Free", "robot": "dual_fr3", "control": "tquat"},
    "two robots by absolute poses": {"task": "Free", "robot": "dual_fr3", "control": "tquat", "relative": False},
    "two robots by absolute joints": {"task": "Free", "robot": "dual_fr3", "relative": False},
    "synchronous": {"task": "Free", "stepping": "sync"},
}

BENCHES: dict[str, dict[str, Any]] = {
    "relative joints": {},
    "absolute joints": {"is_relative": False},
    "relative poses": {"control": "tquat"},
    "absolute poses": {"control": "tquat", "is_relative": False},
    "synchronous": {"is_synchronous": True},
    "two robots by relative joints": {"robots": ("left", "right")},
    "two robots by absolute joints": {"robots": ("left", "right"), "is_relative": False},
    "two robots by relative poses": {"robots": ("left", "right"), "control": "tquat"},
    "two robots by absolute poses": {"robots": ("left", "right"), "control": "tquat", "is_relative": False},
}


class TestSimulated(SafetyContract):
    @pytest.fixture(autouse=True, params=OPTIONS)
    def _options(self, request: pytest.FixtureRequest) -> None:
        self.options = OPTIONS[request.param]

    def make_env(self) -> Env:
        return rcs.make(**{"max_episode_steps": None, **self.options})


class TestFakes(SafetyContract):
    options: ClassVar[dict[str, Any]] = {}

    @pytest.fixture(autouse=True, params=BENCHES)
    def _bench(self, request: pytest.FixtureRequest, make_bench: Callable[..., Any]) -> None:
        self.benches: dict[int, Any] = {}
        self.make_bench = lambda: make_bench(max_episode_steps=None, **BENCHES[request.param])

    def make_env(self) -> Env:
        bench = self.make_bench()
        self.benches[id(bench.env)] = bench
        return bench.env

    def let_time_pass(self, env: Env) -> None:
        self.benches[id(env)].clock.now += 0.5

    def push(self, env: Env) -> None:
        for arm in self.benches[id(env)].arms:
            arm.push(np.array([PUSH, *[0.0] * 6]))

    @pytest.mark.parametrize("which", [0, -1], ids=["the first robot", "the last"])
    @pytest.mark.parametrize("device", ["arms", "grippers"])
    def test_a_fault_ends_the_episode_and_all_devices_hold(self, device: str, which: int) -> None:
        with self.env() as env:
            breaks = self.set_in_motion(env)
            failing = getattr(self.benches[id(env)], device)[which]
            failing.set_fault("touched something")
            observation, reward, terminated, truncated, info = env.step(go(env, lift(env)))
            assert (reward, terminated, truncated, info["end"]) == (0.0, False, True, "fault")
            assert [reason for name, reason in info["faults"].items() if name.endswith(failing.name)] == [
                "touched something"
            ]
            assert env.observation_space.contains(observation)
            self.require_that_all_stand_still(env)
            assert breaks.ends == [("fault", info["faults"])]
            with pytest.raises(WrongOrder):
                env.step(go(env, observation))
            with pytest.raises(DeviceFault, match="touched something"):
                env.reset()
            env.recover()
            self.require_that_all_stand_still(env)
            env.reset()
            env.step(stay(env, lift(env)))

    def test_an_arm_that_refuses_even_to_hold_in_its_reflex_recovers(self) -> None:
        with self.env() as env:
            self.set_in_motion(env)
            arm = self.benches[id(env)].arms[-1]
            arm.trip("cartesian reflex")
            *_, info = env.step(go(env, lift(env)))
            (reason,) = info["faults"].values()
            assert reason.startswith("cartesian reflex")
            self.require_that_all_stand_still(env)
            env.recover()
            self.require_that_all_stand_still(env)
            env.reset()
            env.step(stay(env, lift(env)))

    def test_a_device_that_can_no_longer_be_measured_ends_the_episode_too(self) -> None:
        with self.env() as env:
            breaks = self.set_in_motion(env)
            last = lift(env)
            arm = self.benches[id(env)].arms[-1]
            arm.lose_link()
            observation, _, _, truncated, info = env.step(stay(env, last))
            assert (truncated, info["end"]) == (True, "fault")
            assert any("link" in reason for reason in info["faults"].values())
            assert env.observation_space.contains(observation)
            assert [end for end, _ in breaks.ends] == ["fault"]

    def test_a_fault_ends_the_wait_of_a_step_at_once(self) -> None:
        with self.env() as env:
            self.set_in_motion(env)
            bench = self.benches[id(env)]
            start, sleep = bench.clock.now, bench.clock.sleep

            def sleep_and_fail(seconds: float) -> None:
                sleep(seconds)
                if bench.clock.now - start > 0.004:
                    bench.arms[-1].set_fault("touched something")

            env.clock._sleep = sleep_and_fail
            *_, info = env.step(go(env, lift(env)))
            assert info["end"] == "fault"
            assert bench.clock.now - start < 0.015

    def test_an_action_that_a_device_refuses_holds_all_and_the_episode_goes_on(self) -> None:
        with self.env() as env:
            self.set_in_motion(env)
            arm = self.benches[id(env)].arms[-1]
            narrow = lambda _: (_ for _ in ()).throw(rcs.errors.InvalidAction("beyond my limits"))  # noqa: E731
            arm._command_joints = narrow
            with pytest.raises(rcs.errors.InvalidAction, match="beyond my limits"):
                env.step(go(env, lift(env)))
            del arm._command_joints
            self.require_that_all_stand_still(env)
            self.require_that_stay_moves_nothing(env, joints_of(env))


def stop_inside_of_the_next_step(bench: Any) -> tuple[threading.Event, threading.Event]:
    """Have a step wait in its clock; return what tells that it does, and what lets it go on."""
    is_inside, may_go_on = threading.Event(), threading.Event()

    def wait(seconds: float) -> None:
        is_inside.set()
        assert may_go_on.wait(10)
        bench.clock.now += seconds

    bench.env.clock._sleep = wait
    return is_inside, may_go_on


def test_two_threads_in_one_environment_are_told_apart(make_bench: Callable[..., Any]) -> None:
    bench = make_bench()
    env = bench.env
    observation, _ = env.reset(seed=0)
    is_inside, may_go_on = stop_inside_of_the_next_step(bench)
    thread = threading.Thread(target=env.step, args=(go(env, observation),))
    thread.start()
    assert is_inside.wait(10)
    for call in (lambda: env.step(go(env, observation)), env.reset, env.rebase, env.recover):
        with pytest.raises(WrongOrder, match="another thread"):
            call()
    env.hold()
    before = joints_of(env)[""]
    may_go_on.set()
    thread.join(10)
    env.clock._sleep = bench.clock.sleep
    env.step(stay(env, lift(env)))
    np.testing.assert_allclose(joints_of(env)[""], before, atol=1e-9)
    env.close()


@pytest.mark.parametrize("where", ["map_action", "map_executed"])
def test_hold_from_another_thread_is_not_undone_by_the_step_under_way(
    make_bench: Callable[..., Any], where: str
) -> None:
    bench = make_bench()
    env = bench.env

    class HeldMeanwhile(Layer):
        is_armed = False

        def map_action(self, action: Any) -> Any:
            return self._hold("map_action", action)

        def map_executed(self, executed: Any) -> Any:
            return self._hold("map_executed", executed)

        def _hold(self, here: str, action: Any) -> Any:
            if self.is_armed and here == where:
                thread = threading.Thread(target=env.hold)
                thread.start()
                thread.join(10)
            return action

    layer = HeldMeanwhile()
    env.stack.chains[""].layers.append(layer)
    observation, _ = env.reset(seed=0)
    layer.is_armed = True
    env.step(go(env, observation))
    layer.is_armed = False
    np.testing.assert_allclose(joints_of(env)[""], observation["joints"], atol=1e-9)
    env.step(stay(env, lift(env)))
    np.testing.assert_allclose(joints_of(env)[""], observation["joints"], atol=1e-9)


def test_close_from_another_thread_holds_at_once_and_closes_after_the_step(make_bench: Callable[..., Any]) -> None:
    bench = make_bench()
    env = bench.env
    observation, _ = env.reset(seed=0)
    is_inside, may_go_on = stop_inside_of_the_next_step(bench)
    stepping = threading.Thread(target=env.step, args=(go(env, observation),))
    stepping.start()
    assert is_inside.wait(10)
    held = threading.Event()
    hold = bench.arm._hold
    bench.arm._hold = lambda: (hold(), held.set())
    closing = threading.Thread(target=env.close)
    closing.start()
    assert held.wait(10)
    assert bench.arm.is_open
    may_go_on.set()
    stepping.join(10)
    closing.join(10)
    assert not bench.arm.is_open
    assert not bench.gripper.is_open


def test_one_of_two_robots_can_be_rebased(make_bench: Callable[..., Any]) -> None:
    bench = make_bench(robots=("left", "right"))
    env = bench.env
    env.reset(seed=0)
    for arm in bench.arms:
        arm.push(np.array([0.05, *[0.0] * 6]))
    env.rebase("left")
    env.step(stay(env, lift(env)))
    executed = env.stack.executed
    start = bench.arms[0].state().joints
    np.testing.assert_allclose(executed["left"]["joints"], start, atol=1e-9)
    np.testing.assert_allclose(executed["right"]["joints"][0], start[0] - 0.05, atol=1e-9)
    with pytest.raises(UnknownName, match="middle"):
        env.rebase("middle")
