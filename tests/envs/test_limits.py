"""Limits in force are the narrower of description and device, in every control; an arm found outside may stay."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rcs
from rcs.devices import ArmLimits, ArmState
from rcs.devices.fakes import FakeArm, FakeGripper
from rcs.envs.assemble import assemble
from rcs.envs.control_layers import RETURN_SPEED
from rcs.envs.env import Env
from rcs.envs.gates.gate import Gate
from rcs.envs.setup import Setup
from rcs.hardware import Site
from rcs.robots.fr3 import FR3
from rcs.robots.so101 import SO101
from rcs.setups.make import resolve

HOME = np.array(FR3.home)


class LoggedArm(FakeArm):
    """Remembers what it was told."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.sent: list[NDArray[np.float64]] = []
        self.moments: list[float] = []

    def _command_joints(self, joints: NDArray[np.float64]) -> None:
        super()._command_joints(joints)
        self.sent.append(np.array(joints))
        self.moments.append(self.body.time)


def limits(about: Any = FR3, *, margin: float = 0.0, speed: float | None = None) -> ArmLimits:
    return ArmLimits(
        [low + margin for low in about.joint_lower],
        [high - margin for high in about.joint_upper],
        [speed] * about.dof if speed else list(about.velocity_limit),
    )


class Hall:
    """Real arms of a setup, all fakes on a clock that is moved by hand."""

    def __init__(self, clock: Any, own: ArmLimits, start: NDArray[np.float64] | None = None, **options: Any) -> None:
        setup = Setup(task="Free", **options)
        parts = resolve(setup)
        self.arms = {
            robot.name: LoggedArm(own, start=np.array(robot.arm.home) if start is None else start, clock=clock)
            for robot in parts.robots
        }
        grippers = {robot.name: FakeGripper(clock=clock) for robot in parts.robots}
        robots = {robot.name: (robot.arm, robot.end_effector) for robot in parts.robots}
        devices = Site(arms=self.arms, grippers=grippers).devices(robots, {})
        self.env: Env = assemble(replace(parts, devices=devices, now=clock, sleep=clock.sleep))
        self.arm = next(iter(self.arms.values()))
        self.is_alone = len(self.arms) == 1

    def act(self, **own: Any) -> dict[str, Any]:
        action = {**own, "gripper": np.ones(1, np.float32)}
        return action if self.is_alone else dict.fromkeys(self.arms, action)

    def largest_step(self) -> NDArray[np.float64]:
        """Return the largest way that each joint was sent at once [rad]."""
        return np.max([np.abs(np.diff(arm.sent, axis=0)).max(axis=0) for arm in self.arms.values()], axis=0)


@pytest.mark.parametrize("robot", ["fr3", "dual_fr3"])
@pytest.mark.parametrize("stepping", ["async", "sync"])
def test_a_slow_device_is_shown_and_led_at_its_own_speed(clock: Any, robot: str, stepping: Any) -> None:
    hall = Hall(clock, limits(speed=0.1), robot=robot, relative=False, stepping=stepping)
    for own in hall.env.limits().robots.values():
        np.testing.assert_array_equal(own.joint_velocity, 0.1)
        np.testing.assert_allclose(own.target_velocity, 0.1)
    hall.env.reset(seed=0)
    for _ in range(10 if stepping == "async" else 1):
        hall.env.step(hall.act(joints=HOME + 0.2))
    assert hall.largest_step().max() <= 0.1 / 30 + 1e-9
    assert hall.arm.sent[-1][0] - HOME[0] == pytest.approx(10 * 0.1 / 30 if stepping == "async" else 0.2)
    hall.env.close()


def test_a_device_that_can_do_more_is_led_within_the_description(clock: Any) -> None:
    hall = Hall(clock, limits(margin=-0.3, speed=9.0), relative=False)
    own = hall.env.limits().robots["fr3"]
    np.testing.assert_array_equal(own.joint_upper, FR3.joint_upper)
    np.testing.assert_array_equal(own.joint_velocity, FR3.velocity_limit)
    hall.env.close()


MOTIONS = [
    ("xyzrpy", [0.002, 0, 0, 0, 0, 0]),
    ("xyzrpy", [0, 0, -0.002, 0, 0, 0]),
    ("xyzrpy", [-0.002, 0, 0.002, 0, 0, 0]),
    ("xyzrpy", [0, 0, 0, 0, 0.008, 0]),
    ("xyzrpy", [0, 0, 0, 0, 0, 0.008]),
    ("twist", [0.4, 0, 0, 0, 0, 0]),
    ("twist", [-0.4, 0, 0.3, 0, 0, 0]),
    ("twist", [0, 0, 0, 0, 1.5, 0]),
]


@pytest.mark.parametrize(("control", "motion"), MOTIONS)
def test_motions_of_the_tcp_end_at_the_range_of_the_device(clock: Any, control: Any, motion: list[float]) -> None:
    own = limits(margin=0.3)
    hall = Hall(clock, own, control=control, frequency=200.0, max_episode_steps=None)
    hall.env.reset(seed=0)
    for _ in range(400):
        *_, info = hall.env.step(hall.act(**{control: np.array(motion)}))
    sent = np.array(hall.arm.sent)
    assert ((sent >= own.joint_lower) & (sent <= own.joint_upper)).all()
    assert "faults" not in info
    hall.env.close()


def outside(by: float) -> NDArray[np.float64]:
    """Return joints of an SO101 of which the second is parked below its range."""
    joints = np.array(SO101.home)
    joints[1] = SO101.joint_lower[1] - by
    return joints


class Passes(Gate):
    """Lets everything through."""

    def admit(self, targets: Any, measured: Any) -> Any:
        return {name: dict(own) for name, own in targets.items()}


CONTROLS: list[dict[str, Any]] = [
    {"control": "joints"},
    {"control": "joints", "relative": "origin"},
    {"control": "joints", "gated": True},
    {"control": "joints", "stepping": "sync"},
    {"control": "xyzrpy"},
    {"control": "twist"},
]


@pytest.mark.parametrize("by", [0.05, 0.3])
@pytest.mark.parametrize("options", CONTROLS, ids=str)
def test_an_arm_found_outside_its_range_may_stay(clock: Any, options: dict[str, Any], by: float) -> None:
    own = {name: value for name, value in options.items() if name != "gated"}
    hall = Hall(clock, limits(SO101), outside(by), robot="so101", **own)
    if "gated" in options:
        hall.env.stack.gates.append(Passes())
    observation, _ = hall.env.reset(seed=0)
    nothing = np.zeros(hall.env.action_space[options["control"]].shape)
    for _ in range(5):
        observation, *_, info = hall.env.step(hall.act(**{options["control"]: nothing}))
        assert "refused" not in info
    np.testing.assert_allclose(observation["joints"], outside(by), atol=1e-9)
    hall.env.close()


class Trembling(LoggedArm):
    """Measures a joint that is outside its range at other steps of its encoder each time."""

    STEP = 2 * np.pi / 4096
    number = 0

    def _state(self) -> Any:
        state = super()._state()
        self.number += 1
        joints = np.array(state.joints)
        joints[1] += self.STEP * (self.number % 3)
        return ArmState(list(joints), state.joint_velocities, device_time=state.device_time)


@pytest.mark.parametrize("options", CONTROLS, ids=str)
def test_an_arm_found_outside_may_stay_while_its_encoder_trembles(clock: Any, options: dict[str, Any]) -> None:
    own = {name: value for name, value in options.items() if name != "gated"}
    hall = Hall(clock, limits(SO101), outside(0.05), robot="so101", **own)
    hall.arm.__class__ = Trembling
    if "gated" in options:
        hall.env.stack.gates.append(Passes())
    nothing = np.zeros(hall.env.action_space[options["control"]].shape)
    for _ in range(6):
        hall.env.reset(seed=0)
        *_, info = hall.env.step(hall.act(**{options["control"]: nothing}))
        assert "refused" not in info
        hall.env.hold()
        *_, info = hall.env.step(hall.act(**{options["control"]: nothing}))
        assert "refused" not in info
    hall.env.close()


@pytest.mark.parametrize("stepping", ["async", "sync"])
@pytest.mark.parametrize("relative", ["last_step", "absolute"])
def test_it_comes_back_slowly_and_never_goes_farther_out(clock: Any, stepping: Any, relative: Any) -> None:
    hall = Hall(clock, limits(SO101), outside(0.3), robot="so101", stepping=stepping, relative=relative)
    env, low = hall.env, SO101.joint_lower[1]
    observation, _ = env.reset(seed=0)
    step = 0.02 * np.arange(5)
    if relative == "last_step":
        observation, *_ = env.step(hall.act(joints=-step))
        assert observation["joints"][1] == pytest.approx(low - 0.3)
    for _ in range(300):
        env.step(hall.act(joints=step if relative == "last_step" else np.array(SO101.home)))
        if hall.arm.sent[-1][1] > low + 0.1:
            break
    joint = np.array(hall.arm.sent)[:, 1]
    assert joint[-1] > low + 0.1
    assert (np.diff(joint) >= -1e-9).all()
    is_back = joint >= low - 0.02  # as far out as servos carry a joint
    assert np.diff(joint)[~is_back[:-1]].max() <= RETURN_SPEED / 30 + 1e-9
    env.close()


def test_a_synchronous_step_is_sent_in_parts_at_the_control_frequency(clock: Any) -> None:
    hall = Hall(clock, limits(), relative=False, stepping="sync")
    hall.env.reset(seed=0)
    goal = HOME + np.array([1.0, -0.5, 0.0, 0.0, 0.0, 0.0, -1.5])
    observation, *_, info = hall.env.step(hall.act(joints=goal))
    assert info["end"] == "converged"
    np.testing.assert_allclose(observation["joints"], goal, atol=1e-6)
    assert (hall.largest_step() <= np.array(FR3.velocity_limit) / 30 + 1e-9).all()
    assert np.diff(hall.arm.moments).min() >= 1 / 30 - 1e-9
    way = np.array(hall.arm.sent) - HOME
    np.testing.assert_allclose(way[:, 1], -0.5 * way[:, 0], atol=1e-9, err_msg="a straight line in joint space")
    hall.env.close()


class Sagging(LoggedArm):
    """Never comes quite where it is sent."""

    def _has_arrived(self) -> bool:
        return False


def test_a_synchronous_step_of_a_servo_that_sags_ends_when_the_setup_says(clock: Any) -> None:
    hall = Hall(clock, limits(), stepping="sync", sync_time_limit=0.4)
    hall.arm.__class__ = Sagging
    hall.env.reset(seed=0)
    start = clock.now
    *_, info = hall.env.step(hall.act(joints=np.full(7, 0.01)))
    assert info["end"] == "limit"
    assert clock.now - start == pytest.approx(0.4, abs=0.01)
    hall.env.close()


def test_a_blocked_arm_is_not_led_on_in_a_synchronous_step(clock: Any) -> None:
    hall = Hall(clock, limits(), relative=False, stepping="sync", sync_time_limit=3.0)
    hall.env.reset(seed=0)
    hall.arm.body._speed = np.zeros(7)
    *_, info = hall.env.step(hall.act(joints=HOME + 0.9))
    assert info["end"] == "limit"
    assert (hall.arm.sent[-1] - HOME <= np.array(FR3.motion_limits.lead(1 / 30)) + 1e-9).all()
    hall.env.close()


def test_hold_ends_a_synchronous_step_and_its_way(clock: Any) -> None:
    hall = Hall(clock, limits(), relative=False, stepping="sync")
    env = hall.env
    env.reset(seed=0)
    inner, count = env.clock._sleep, []

    def hold_after_a_while(seconds: float) -> None:
        inner(seconds)
        count.append(seconds)
        if len(count) == 100:
            env.hold()

    env.clock._sleep = hold_after_a_while
    observation, *_ = env.step(hall.act(joints=HOME + 0.9))
    assert 0.1 < (observation["joints"] - HOME)[0] < 0.5
    assert len(count) < 110
    sent = len(hall.arm.sent)
    observation, *_ = env.step(hall.act(joints=observation["joints"]))
    np.testing.assert_allclose(hall.arm.sent[sent], observation["joints"], atol=1e-9)
    env.close()


def test_simulated_limits_are_those_of_the_description() -> None:
    own = rcs.make("Free").limits().robots["fr3"]
    np.testing.assert_array_equal(own.joint_lower, FR3.joint_lower)
    np.testing.assert_allclose(own.target_velocity, FR3.velocity_limit)


@pytest.mark.parametrize("frequency", [10.0, 30.0, 100.0])
@pytest.mark.parametrize("robot", ["fr3", "ur5e"])
def test_a_far_target_is_gone_to_at_once_without_turning_back_or_going_past(robot: str, frequency: float) -> None:
    with rcs.make("Free", robot=robot, relative=False, frequency=frequency, max_episode_steps=None) as env:
        observation, _ = env.reset(seed=0)
        body = env.simulation.robots[0]
        led: list[NDArray[np.float64]] = []
        env.simulation.world.on_period(lambda view: led.append(np.array(body.motion.state(view))), 0.002)
        start = np.array(observation["joints"])
        way = np.zeros_like(start)
        way[0] = 2.0
        for _ in range(round(3.0 * frequency)):
            env.step({"joints": start + way, "gripper": np.ones(1, np.float32)})
        position, velocity, acceleration = np.array(led).transpose(1, 0, 2)[:, :, 0]
        assert (start[0] - position).max() < 1e-3
        assert (position - start[0] - 2.0).max() < 0.03
        signs = np.sign(acceleration[np.abs(acceleration) > 1e-6])
        assert np.count_nonzero(np.diff(signs)) <= 3
        assert velocity.max() > 0.75 * env.robots[robot].arm.velocity_limit[0]
