"""Requests of an environment to devices: commands that end, measurements that are new, reads that nobody waits for."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.devices import ArmState, GripperState, HandState, StreamedArm, StreamOptions, StreamPoint
from rcs.devices.fakes import FakeArm, FakeGripper, FakeHand
from rcs.envs.env import Env
from rcs.envs.ports.device_calls import Freshness
from rcs.errors import DeviceFault
from rcs.hardware import Site
from rcs.robots.fr3 import FR3

HOME = np.array(FR3.home)
GO = {"joints": np.full(7, 0.01), "gripper": np.ones(1, np.float32)}
STAY = {**GO, "joints": np.zeros(7)}


def make(arm: FakeArm | None = None, gripper: Any = None, *, frequency: float = 50.0, **options: Any) -> Env:
    """Make an FR3 of two devices, by default without a limit of age."""
    names = ("valid_for", "stale_after", "arm_stale_after")
    ages = {"stale_after": 60.0, "arm_stale_after": 60.0}
    given = {**ages, **{name: options.pop(name) for name in names if name in options}}
    effector = FakeGripper() if gripper is None else gripper
    kind = "hands" if isinstance(effector, FakeHand) else "grippers"
    site = Site(arms={"fr3": home_arm() if arm is None else arm}, **{kind: {"fr3": effector}}, **given)
    if kind == "hands":
        options.update(end_effector="tilburg_hand", binary_gripper=False)
    return rcs.make("Free", hardware=site, frequency=frequency, max_episode_steps=None, **options)


def home_arm(kind: type[FakeArm] = FakeArm) -> FakeArm:
    return kind(FR3.arm_limits, start=HOME)


def wait_for(condition: Callable[[], bool], seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it took too long"
        time.sleep(1e-3)


# --- Commands end -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("valid_for", [None, 0.06])
def test_what_was_commanded_ends_while_nobody_acts(valid_for: float | None) -> None:
    arm, gripper = home_arm(), FakeGripper(speed=0.2)
    arm.body._speed = np.full(7, 5e-3)  # it needs seconds for one step of an action
    with make(arm, gripper, valid_for=valid_for) as env:
        env.reset(seed=0)
        env.step({"joints": np.full(7, 0.03), "gripper": np.zeros(1, np.float32)})
        ended = [np.array(HOME + 0.03), np.zeros(1)]
        wait_for(lambda: bool((arm.body.target != ended[0]).any() and (gripper.body.target != ended[1]).any()))
        for device, start, goal in ((arm, HOME, ended[0]), (gripper, np.ones(1), ended[1])):
            stands = device.body.values.copy()
            assert ((stands - start) * (goal - start) > 0).all(), "it has moved"
            assert (np.abs(stands - start) < np.abs(goal - start)).all(), "and not all of the way"
            time.sleep(0.02)
            device.state()
            np.testing.assert_array_equal(device.body.values, stands)
            assert not device.fault


def test_a_hand_too_ends_what_it_was_told() -> None:
    hand = FakeHand(16, speed=0.2)
    with make(gripper=hand) as env:
        env.reset(seed=0)
        env.step({"joints": np.zeros(7), "hand": np.ones(16, np.float32)})
        wait_for(lambda: bool((hand.body.target < 1.0).all()))
        assert (hand.body.values > 0.0).all()


def test_a_synchronous_step_ends_where_it_was_told_to_however_long_it_takes() -> None:
    arm = home_arm()
    arm.body._speed = np.full(7, 0.1)
    with make(arm, stepping="sync") as env:
        env.reset(seed=0)
        *_, info = env.step({**STAY, "joints": np.full(7, 0.03)})  # 0.3 s, far more than three periods
        assert info["end"] == "converged"
        np.testing.assert_allclose(arm.state().joints, HOME + 0.03, atol=1e-6)


# --- Measurements are new ---------------------------------------------------------------------------------------------


class Cached(FakeArm):
    """An arm whose library repeats its last answer when the cable is out."""

    is_cut = False
    has_clock = False
    last: ArmState | None = None

    def _state(self) -> ArmState:
        if not self.is_cut or self.last is None:
            new = super()._state()
            when = new.device_time if self.has_clock else float("nan")
            self.last = ArmState(new.joints, new.joint_velocities, device_time=when)
        return self.last


class OldState(FakeArm):
    """An arm whose driver says when it measured."""

    age = 0.0

    def _state(self) -> ArmState:
        return ArmState(super()._state().joints, [0.0] * self.dof, time=time.monotonic() - self.age)


def steps_until_fault(env: Env, action: dict[str, Any], most: int = 400) -> dict[str, Any]:
    for _ in range(most):
        *_, truncated, info = env.step(action)
        if truncated:
            return info
    raise AssertionError("there was no fault")


@pytest.mark.parametrize("action", [GO, STAY], ids=["going", "staying"])
def test_a_device_whose_clock_stands_still_is_in_its_fault_state(action: dict[str, Any]) -> None:
    arm = home_arm(Cached)
    arm.has_clock = True  # pyright: ignore[reportAttributeAccessIssue]
    with make(arm, arm_stale_after=0.1) as env:
        env.reset(seed=0)
        arm.is_cut = True  # pyright: ignore[reportAttributeAccessIssue]
        begin = time.monotonic()
        observation, *_, info = env.step(action)
        assert info["ages"]["joints"] > 0.01, "the age is that of the measurement, not of the call"
        info = steps_until_fault(env, action)
        assert time.monotonic() - begin > 0.09  # the last new measurement came a little before
        assert info["end"] == "fault"
        assert "nothing new measured for 0.1" in info["faults"]["fake arm"]
        assert "nothing new measured" in arm.fault
        env.recover()
        with pytest.raises(DeviceFault, match="nothing new measured"):
            env.reset(seed=0)
        arm.is_cut = False  # pyright: ignore[reportAttributeAccessIssue]
        env.recover()
        env.reset(seed=0)
        env.step(STAY)


def test_an_arm_without_a_clock_does_not_run_ahead_of_numbers_that_repeat() -> None:
    arm = home_arm(Cached)
    with make(arm, arm_stale_after=0.1) as env:
        env.reset(seed=0)
        for _ in range(10):
            env.step(GO)
        arm.is_cut = True  # pyright: ignore[reportAttributeAccessIssue]
        start = np.array(arm.last.joints)  # pyright: ignore[reportAttributeAccessIssue]
        info = steps_until_fault(env, GO)
        assert "nothing new measured" in info["faults"]["fake arm"]
        assert np.abs(arm.body.values - start).max() < 0.2
        assert np.abs(arm.body.target - arm.body.values).max() == 0.0


def test_an_arm_without_a_clock_may_stand_still_for_ever() -> None:
    arm = home_arm(Cached)
    with make(arm, arm_stale_after=0.02) as env:
        env.reset(seed=0)
        arm.is_cut = True  # pyright: ignore[reportAttributeAccessIssue]
        for _ in range(15):
            *_, truncated, _ = env.step(STAY)
            assert not truncated


def test_numbers_that_repeat_are_old_from_when_the_arm_is_led_not_from_a_pause_of_the_program_before() -> None:
    with home_arm(FakeArm) as arm:
        freshness = Freshness(arm, stale_after=0.1)

        def judge(ahead: float) -> None:
            freshness.judge(ArmState(HOME, [0.0] * arm.dof, time=time.monotonic()), HOME + ahead)

        judge(0.0)
        time.sleep(0.15)
        judge(0.2)
        assert arm.fault == ""
        time.sleep(0.15)
        judge(0.2)
        assert "nothing new measured for 0.1" in arm.fault


def test_an_arm_that_says_when_it_measured_is_taken_at_its_word() -> None:
    arm = home_arm(OldState)
    with make(arm, arm_stale_after=0.2) as env:
        env.reset(seed=0)
        *_, truncated, info = env.step(STAY)
        assert not truncated
        arm.age = 1.0  # pyright: ignore[reportAttributeAccessIssue]
        *_, truncated, info = env.step(STAY)
        assert truncated
        assert "nothing new measured for 1.0" in info["faults"]["fake arm"]


class CachedGripper(FakeGripper):
    is_cut = False
    last: GripperState | None = None

    def _state(self) -> GripperState:
        if not self.is_cut or self.last is None:
            self.last = super()._state()
        return self.last


class CachedHand(FakeHand):
    is_cut = False
    last: HandState | None = None

    def _state(self) -> HandState:
        if not self.is_cut or self.last is None:
            self.last = super()._state()
        return self.last


@pytest.mark.parametrize("make_effector", [CachedGripper, lambda: CachedHand(16)])
def test_grippers_and_hands_grow_stale_too(make_effector: Callable[[], Any]) -> None:
    effector = make_effector()
    with make(gripper=effector, stale_after=0.1) as env:
        env.reset(seed=0)
        effector.is_cut = True
        key = "hand" if isinstance(effector, FakeHand) else "gripper"
        stay = {"joints": np.zeros(7), key: np.ones(16 if key == "hand" else 1, np.float32)}
        info = steps_until_fault(env, stay)
        assert "nothing new measured" in info["faults"][effector.name]


# --- Nobody waits for a slow read -------------------------------------------------------------------------------------


class SlowGripper(FakeGripper):
    """A gripper that is asked over a slow line, one call at a time."""

    takes = 0.08

    def __init__(self) -> None:
        super().__init__(speed=20.0)
        self.reads: list[str] = []
        self.sent: list[float] = []
        self.inside = 0
        self.crowd = 0
        self.may_answer = threading.Event()
        self.may_answer.set()

    def _call(self) -> None:
        self.inside += 1
        self.crowd = max(self.crowd, self.inside)
        time.sleep(self.takes)
        self.may_answer.wait(30.0)
        self.inside -= 1

    def _state(self) -> GripperState:
        self.reads.append(threading.current_thread().name)
        self._call()
        return super()._state()

    def _command_opening(self, opening: float, force: float | None) -> None:
        self.sent.append(opening)
        self._call()
        super()._command_opening(opening, force)


@pytest.fixture
def slow(monkeypatch: pytest.MonkeyPatch) -> Iterator[SlowGripper]:
    monkeypatch.setattr("rcs.envs.ports.device_calls.LONGEST_CALL", 0.5)
    gripper = SlowGripper()
    yield gripper
    gripper.may_answer.set()
    wait_for(lambda: not any(thread.name.startswith("fake gripper") for thread in threading.enumerate()))


def test_a_slow_gripper_does_not_hold_up_the_loop_and_its_age_is_told(slow: SlowGripper) -> None:
    with make(gripper=slow, frequency=100.0) as env:
        env.reset(seed=0)
        for _ in range(3):
            env.step(STAY)
        reads, steps, ages = len(slow.reads), 0, []
        while len(slow.reads) < reads + 4:
            ages.append(env.step({**STAY, "gripper": np.zeros(1, np.float32)})[-1]["ages"]["gripper"])
            steps += 1
        assert steps > 2 * 4, "a loop that waited would make at most one step per read"
        assert max(ages) > 0.5 * slow.takes
        wait_for(lambda: slow.body.values[0] < 0.01 or env.step({**STAY, "gripper": np.zeros(1, np.float32)}) is None)
        assert slow.crowd == 1, "calls come one at a time"
        assert not slow.fault
    assert not slow.is_open


def test_a_slow_gripper_goes_all_the_way_and_stops_at_hold(slow: SlowGripper) -> None:
    slow.body._speed = np.array([2.0])
    with make(gripper=slow, frequency=100.0) as env:
        env.reset(seed=0)
        for _ in range(3):
            env.step(STAY)
        close = {**STAY, "gripper": np.zeros(1, np.float32)}
        wait_for(lambda: env.step(close) is not None and bool(slow.body.values[0] < 0.9))
        env.hold()
        stands = slow.body.values.copy()
        time.sleep(3 * slow.takes)
        slow.body.move()
        assert np.abs(slow.body.values - stands).max() < 2.0 * 2.5 * slow.takes, "a call that was under way may end"
        stands = slow.body.values.copy()
        time.sleep(slow.takes)
        slow.body.move()
        np.testing.assert_array_equal(slow.body.values, stands)


def test_what_a_slow_gripper_raises_on_its_thread_is_its_fault(slow: SlowGripper) -> None:
    with make(gripper=slow, frequency=100.0) as env:
        env.reset(seed=0)
        for _ in range(3):
            env.step(STAY)
        slow.lose_link()
        info = steps_until_fault(env, STAY)
        assert "the link is lost" in info["faults"]["fake gripper"]
        slow.restore()
        env.recover()
        env.reset(seed=0)
        *_, truncated, _ = env.step(STAY)
        assert not truncated


def test_a_slow_gripper_that_no_longer_answers_grows_stale_and_keeps_nobody_from_closing(
    slow: SlowGripper, caplog: pytest.LogCaptureFixture
) -> None:
    env = make(gripper=slow, frequency=100.0, stale_after=0.4)
    env.reset(seed=0)
    for _ in range(3):
        env.step(STAY)
    slow.may_answer.clear()
    info = steps_until_fault(env, STAY)
    assert "nothing new measured" in info["faults"]["fake gripper"]
    env.close()
    env.close()
    assert "fake gripper has not returned" in caplog.text


class Servo(StreamedArm):
    """An FR3 whose joints are where the points say."""

    def __init__(self) -> None:
        super().__init__("servo", FR3.arm_limits, StreamOptions(rate=100.0, missed_ticks=1000, silence=5.0))
        self.joints, self.velocities = np.array(FR3.home), np.zeros(FR3.dof)

    def _read(self) -> ArmState:
        return ArmState(list(self.joints), list(self.velocities))

    def _write(self, point: StreamPoint) -> None:
        self.joints, self.velocities = point.position, point.velocity

    def _stop(self) -> None:
        pass

    def _clear(self) -> None:
        pass


def test_a_streamed_arm_knows_the_rate_of_its_commands_and_tells_what_it_clamps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    arm = Servo()
    with rcs.make("Free", robot="fr3", frequency=20.0, hardware=Site(arms={"fr3": arm})) as env:
        assert arm.period == pytest.approx(0.05)
        env.reset()
        *_, info = env.step(STAY)
        assert info["clamped"] == {"servo": arm.clamped()}
        assert not any(arm.clamped().values())
        monkeypatch.setattr(arm, "clamped", lambda: {"speed": 3})
        *_, info = env.step(STAY)
        assert info["clamped"] == {"servo": {"speed": 3}}
