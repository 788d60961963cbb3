"""A twin beside a stand-in with delay and noise: lag and errors are right, and a stand-in that freezes is found at
once."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs import Alarm, Twin
from rcs.envs.assemble import assemble
from rcs.envs.env import Env
from rcs.errors import InvalidSetup
from rcs.hardware import Site
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.robots.ur5e import UR5E
from rcs.setups.make import resolve
from rcs.virtual import SimDriver, StandInArm
from tests.joint_sweep import JointSweep

NOISE = 5e-4
LAG_TOLERANCE = 1e-3
"""How well a lag is found [s]: half a step of the physics of twin and stand-in."""
DESCRIPTIONS = {"fr3": FR3, "dual_fr3": FR3, "ur5e": UR5E}


def bench(
    clock: Any, *, delay: float, noise: float = NOISE, robot: str = "fr3", frequency: float = 30.0
) -> tuple[Env, dict[str, StandInArm]]:
    """Return an environment with stand-ins for its arms, on a clock that is moved by hand."""
    setup = rcs.Setup(task="Free", robot=robot, relative="absolute", frequency=frequency, max_episode_steps=None)
    parts = resolve(setup)
    robots = {one.name: (one.arm, one.end_effector) for one in parts.robots}
    arms = {
        name: StandInArm(DESCRIPTIONS[robot], delay=delay, noise=noise, seed=i, clock=clock, name=name)
        for i, name in enumerate(robots)
    }
    grippers = {one.name: SimDriver(clock).gripper("", one.gripper, {}) for one in parts.robots}
    devices = Site(arms=arms, grippers=grippers).devices(robots, {})
    return assemble(replace(parts, devices=devices, now=clock, sleep=clock.sleep)), arms


def run(env: Env, agent: JointSweep, steps: int, observation: Any, info: Any) -> tuple[Any, Any]:
    for _ in range(steps):
        observation, _, terminated, truncated, info = env.step(agent.act(observation, info))
        if terminated or truncated:
            break
    return observation, info


@pytest.mark.parametrize("delay", [0.01, 0.03, 0.05])
@pytest.mark.parametrize("robot", ["fr3", "ur5e", "dual_fr3"])
def test_lag_and_errors_of_every_joint_are_those_of_the_stand_in(clock: Any, robot: str, delay: float) -> None:
    env, _ = bench(clock, delay=delay, robot=robot)
    twin, agent = Twin(env.robots), JointSweep(env)
    env.add_observer(twin)
    with env:
        agent.reset(*env.reset())
        run(env, agent, 150, {}, {})
        for one in twin.comparisons.values():
            assert one.lag == pytest.approx(delay, abs=LAG_TOLERANCE)
            np.testing.assert_allclose(one.rms, NOISE, rtol=0.4)
            assert (one.raw_rms > one.rms).all()
            assert one.alarm is None


def test_without_noise_a_twin_in_the_loop_is_the_robot_itself_some_time_ago(clock: Any) -> None:
    env, _ = bench(clock, delay=0.03, noise=0.0)
    twin, agent = Twin(env.robots), JointSweep(env)
    env.add_observer(twin)
    with env:
        agent.reset(*env.reset())
        run(env, agent, 150, {}, {})
        assert twin.comparisons["fr3"].rms.max() < 2e-4  # it carries a hand, the stand-in does not


@pytest.mark.parametrize("delay", [0.01, 0.03, 0.05])
@pytest.mark.parametrize("steps", [41, 53, 67, 131])  # in motion; the turning points are elsewhere
def test_an_alarm_comes_within_100_ms_when_the_stand_in_stops_following(clock: Any, delay: float, steps: int) -> None:
    alarms: list[Alarm] = []
    env, arms = bench(clock, delay=delay)
    env.add_observer(Twin(env.robots, on_alarm=alarms.append))
    agent = JointSweep(env)
    with env:
        agent.reset(*env.reset())
        observation, info = run(env, agent, steps, {}, {})
        assert not alarms
        frozen = clock()
        arms["fr3"].freeze()
        run(env, agent, 10, observation, info)
    assert len(alarms) == 1  # one per robot and episode
    assert alarms[0].time - frozen <= 0.1
    assert alarms[0].robot == "fr3"
    assert "rad from its twin" in str(alarms[0])


def test_of_two_robots_the_one_that_stops_is_named(clock: Any) -> None:
    env, arms = bench(clock, delay=0.02, robot="dual_fr3")
    twin, agent = Twin(env.robots), JointSweep(env)
    env.add_observer(twin)
    with env:
        agent.reset(*env.reset())
        observation, info = run(env, agent, 60, {}, {})
        arms["right"].freeze()
        _, info = run(env, agent, 10, observation, info)
        assert info["twin"]["right"]["alarm"].startswith("right: ")
        assert info["twin"]["left"]["alarm"] == ""


def test_there_is_no_alarm_in_minutes_of_normal_following_with_pauses_holds_and_resets(clock: Any) -> None:
    env, _ = bench(clock, delay=0.05, noise=1e-3)
    twin, agent = Twin(env.robots), JointSweep(env, amplitude=0.5, period=2.5)
    env.add_observer(twin)
    with env:
        for seed in range(3):
            observation, info = env.reset(seed=seed)
            agent.reset(observation, info)
            for part in range(4):
                observation, info = run(env, agent, 180, observation, info)
                assert not any(one.alarm for one in twin.comparisons.values())
                if part % 2:
                    env.hold()
                    agent.reset(observation, info)
                else:
                    clock.now += 3.0  # somebody thinks
                    agent.reset(observation, info)


def test_a_new_episode_begins_without_an_alarm(clock: Any) -> None:
    env, arms = bench(clock, delay=0.02)
    twin, agent = Twin(env.robots), JointSweep(env)
    env.add_observer(twin)
    with env:
        agent.reset(*env.reset())
        run(env, agent, 50, {}, {})
        arms["fr3"].freeze()
        run(env, agent, 10, {}, {})
        assert twin.comparisons["fr3"].alarm
        arms["fr3"].thaw()
        agent.reset(*env.reset())
        run(env, agent, 50, {}, {})
        assert twin.comparisons["fr3"].alarm is None


def in_real_time(**options: Any) -> tuple[Env, StandInArm]:
    arm = StandInArm(FR3, gripper=FRANKA_HAND, delay=0.03, noise=NOISE)
    return rcs.make("Free", relative=False, hardware={"fr3": arm, "fr3/gripper": "fake"}, **options), arm


def test_beside_the_loop_and_in_real_time_an_alarm_has_all_devices_hold_and_ends_the_episode() -> None:
    env, arm = in_real_time()
    agent = JointSweep(env, amplitude=0.4)
    with env, rcs.attach_twin(env, on_alarm="hold") as twin:
        agent.reset(*env.reset())
        observation, info = run(env, agent, 60, {}, {})
        assert "faults" not in info
        arm.freeze()
        frozen = time.monotonic()
        _, info = run(env, agent, 30, observation, info)
        assert time.monotonic() - frozen < 0.5
        assert info["end"] == "fault"
        assert "twin: fr3" in info["faults"][arm.name]
        for port in env.stack.ports:  # the twin's thread tells one device after the other
            assert port.device is not None
            end = time.monotonic() + 5.0
            while not port.device.fault and time.monotonic() < end:
                time.sleep(0.01)
            assert "twin: fr3" in port.device.fault
        assert twin.comparisons["fr3"].alarm is not None


def test_an_alarm_can_call_a_function_or_only_be_told() -> None:
    alarms: list[Alarm] = []
    for on_alarm in ("info", alarms.append):
        env, arm = in_real_time()
        agent = JointSweep(env, amplitude=0.4)
        with env, rcs.attach_twin(env, on_alarm=on_alarm):
            agent.reset(*env.reset())
            run(env, agent, 40, {}, {})
            arm.freeze()
            _, info = run(env, agent, 15, {}, {})
            assert "rad from its twin" in info["twin"]["fr3"]["alarm"]
            assert "faults" not in info
    assert len(alarms) == 1


def test_a_twin_of_what_is_not_in_real_time_is_refused() -> None:
    with rcs.make("Free") as env, pytest.raises(InvalidSetup, match="real time"), rcs.attach_twin(env):
        pass


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda env: Twin(env.robots, limit=0.0), "limit is 0.0"),
        (lambda env: Twin({}), "0 robots"),
        (lambda env: rcs.attach_twin(env, on_alarm="ring").__enter__(), "on_alarm is 'ring'"),
        (lambda env: rcs.attach_twin(env, on_alarm="hold").__enter__(), "simulated robots hold"),
    ],
)
def test_options_that_make_no_sense_are_refused(make: Callable[[Env], Any], words: str) -> None:
    with rcs.make("Free", stepping="realtime") as env, pytest.raises(InvalidSetup, match=words):
        make(env)
