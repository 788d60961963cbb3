"""Poses and twists that a streamed arm hands to its controller, and commands at any rate."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.devices import ArmLimits, ArmState, CommandKind, StreamedArm, StreamOptions, StreamPoint
from rcs.devices.fakes import FakeGripper
from rcs.errors import DeviceFault, InvalidAction
from rcs.hardware import Site
from rcs.robots import FR3, SO101
from tests.devices.servo import START, Servo, await_fault


class Mover(Servo):
    """A servo that takes velocities, too, and comes to rest from them in ten ticks."""

    def __init__(self, **options: Any) -> None:
        super().__init__(is_paced_by_read=True, more_commands={CommandKind.velocities}, **options)
        self.braked = 0

    def _write_other(self, kind: CommandKind, values: Any) -> None:
        assert kind == CommandKind.velocities
        self.joints, self.velocities, self.braked = self.joints + values / 250.0, values, 0

    def _brake_other(self) -> bool:
        self.braked += 1
        self.velocities = self.velocities * 0.0 if self.braked >= 10 else self.velocities * 0.5
        self.joints = self.joints + self.velocities / 250.0
        return self.braked >= 10


class Restless(Mover):
    """A mover whose controller never says that it stands."""

    def _brake_other(self) -> bool:
        return False


def test_an_arm_that_never_comes_to_rest_is_stopped_when_it_is_closed() -> None:
    arm = Restless().open_and_wait()
    arm.command_velocities(np.array([0.5, 0.0, 0.0]))
    arm.advance(10)
    arm.run_freely()
    began = time.monotonic()
    arm.close()
    assert "stop" in arm.calls
    assert 0.9 < time.monotonic() - began < 10.0


def test_other_commands_go_to_the_arm_as_they_are_in_every_tick() -> None:
    with Mover().open_and_wait() as arm:
        assert arm.commands() == {CommandKind.joints, CommandKind.velocities}
        arm.command_velocities(np.array([0.5, 0.0, -0.5]))
        arm.advance(50)
        assert arm.joints - START == pytest.approx([0.1, 0.0, -0.1], abs=0.005)
        assert arm.points == []
        assert not arm.has_arrived()
        arm.run_freely()


def test_other_commands_end_with_a_hold_or_with_their_time_and_joints_lead_from_there() -> None:
    with Mover().open_and_wait() as arm:
        arm.command_velocities(np.array([0.5, 0.0, 0.0]))
        arm.advance(10)
        arm.hold()
        arm.advance(12)
        assert arm.has_arrived()
        at_rest = arm.joints.copy()
        arm.advance(5)
        assert (arm.joints == at_rest).all()
        arm.command_velocities(np.array([0.5, 0.0, 0.0]), valid_for=0.02)
        time.sleep(0.03)
        arm.advance(15)
        assert arm.has_arrived()
        arm.command_joints(arm.joints + 0.01)
        arm.advance(100)
        assert arm.joints == pytest.approx(at_rest + 0.01, abs=0.02)
        arm.run_freely()


def test_another_kind_of_command_is_refused_while_the_arm_moves() -> None:
    with Mover().open_and_wait() as arm:
        arm.command_velocities(np.array([0.5, 0.0, 0.0]))
        arm.advance(5)
        with pytest.raises(InvalidAction, match="another kind of command"):
            arm.command_joints(arm.joints)
        arm.command_velocities(np.array([0.2, 0.0, 0.0]))
        arm.hold()
        arm.advance(12)
        arm.command_joints(arm.joints + 0.1)
        arm.advance(5)
        with pytest.raises(InvalidAction, match="another kind of command"):
            arm.command_velocities(np.array([0.1, 0.0, 0.0]))
        arm.run_freely()


def test_other_commands_that_fail_are_a_fault() -> None:
    class Broken(Mover):
        def _write_other(self, kind: CommandKind, values: Any) -> None:
            raise DeviceFault("the motor of joint 2 is off")

    with Broken().open_and_wait() as arm:
        arm.command_velocities(np.array([0.5, 0.0, 0.0]))
        arm.run_freely()
        await_fault(arm)
        assert "joint 2 is off" in arm.fault
        assert "stop" in arm.calls


def test_a_command_that_comes_while_an_arm_breaks_down_is_not_refused_for_its_distance() -> None:
    class Slow(Servo):
        """Its controller takes its time to stop; only then is the fault known."""

        def _stop(self) -> None:
            super()._stop()
            time.sleep(0.3)

    with Slow() as arm:
        arm.command_joints(START)
        time.sleep(0.1)
        arm.has_reflex = True
        while "stop" not in arm.calls:
            time.sleep(1e-3)
        assert arm.fault == ""
        arm.command_joints(START + 0.3)
        time.sleep(0.4)
        assert "reflex" in arm.fault
        count = len(arm.points)
        arm.recover()
        time.sleep(0.1)
        assert len(arm.points) == count


def test_commands_go_on_while_the_first_one_starts_an_arm_that_takes_its_time() -> None:
    class Slow(Servo):
        def _start(self) -> None:
            super()._start()
            time.sleep(0.3)

    with Slow() as arm:
        arm.command_joints(START)
        while "start" not in arm.calls:
            time.sleep(1e-3)
        arm.command_joints(START + 0.3)
        time.sleep(0.25)
        assert not arm.points
        end = time.monotonic() + 3.0
        while not arm.has_arrived():
            assert time.monotonic() < end
            time.sleep(0.01)
        assert arm.joints == pytest.approx(START + 0.3, abs=1e-6)
        assert np.abs(np.diff([point.position for point in arm.points], axis=0)).max() <= 3.0 / 250 + 1e-9


def test_an_arm_that_is_being_switched_on_measures_nothing_and_says_so() -> None:
    class Slow(Servo):
        def _start(self) -> None:
            super()._start()
            time.sleep(0.6)

    limits = ArmLimits(FR3.joint_lower, FR3.joint_upper, FR3.velocity_limit, [10.0] * 7, [500.0] * 7)
    arm = Slow(limits, FR3.home)
    site = Site(arms={"fr3": arm}, grippers={"fr3": FakeGripper()})
    with rcs.make("Free", hardware=site) as env:
        env.reset(seed=0)
        modes = set()
        for _ in range(30):
            *_, truncated, info = env.step({"joints": np.zeros(7), "gripper": np.ones(1)})
            modes.add(arm.state().mode)
            assert not truncated, info
        assert modes == {"starting", ""}


def test_a_command_that_came_too_late_before_a_close_moves_nothing_after_the_next_open() -> None:
    arm = Servo(rate=10.0, period=0.1)
    arm.open()
    time.sleep(0.03)  # between two ticks
    arm.command_joints(START + 0.15)
    arm.close()
    with arm:
        time.sleep(0.3)
        assert "start" not in arm.calls
        assert not arm.points
        arm.command_joints(START)
        time.sleep(0.3)
        assert arm.has_arrived()


@pytest.mark.parametrize(("rate", "period"), [(100.0, 1 / 90), (500.0, 1 / 90), (100.0, 1 / 30), (1000.0, 1 / 30)])
def test_commands_at_any_rate_do_not_lead_a_joint_out_of_its_range(rate: float, period: float) -> None:
    margin = 0.01
    limits = ArmLimits(SO101.joint_lower, SO101.joint_upper, [2.8] * 5, [15.0] * 5, [3000.0] * 5)
    lower, upper = np.array(SO101.joint_lower), np.array(SO101.joint_upper)

    class Hurried(StreamedArm):
        """Goes there and back at full speed, as far as the range goes, at the rate of commands."""

        def __init__(self) -> None:
            options = {"tracking_error": 10.0, "margin": margin, "is_paced_by_read": True}
            super().__init__("hurried", limits, StreamOptions(rate=rate, period=period, **options))
            self.target = self.joints = np.array(SO101.home)
            self.points: list[Any] = []
            self.count, self.passed, self.way = 0, 0.0, np.zeros(5)
            self.random = np.random.default_rng(0)

        def _read(self) -> ArmState:
            return ArmState(self.joints, np.zeros(5))

        def _stop(self) -> None:
            pass

        def _write(self, point: StreamPoint) -> None:
            self.joints = point.position
            self.points.append(point.position)
            self.passed += 1 / rate
            if self.passed < period or self.count > 600:
                return
            self.passed -= period
            if self.count % 20 == 0:
                self.way = 2.8 * period * np.where(self.random.random(5) < 0.5, -1.0, 1.0)
            self.count += 1
            self.target = np.clip(self.target + self.way * self.random.choice([1.0, 0.5]), lower, upper)
            self.command_joints(self.target)

    with Hurried() as arm:
        arm.command_joints(arm.joints)
        end = time.monotonic() + 30.0
        while arm.count <= 600:
            assert time.monotonic() < end
            time.sleep(0.01)
    points = np.array(arm.points)
    assert np.ptp(points, axis=0).max() > 2.0
    assert (points <= upper - margin + 1e-5).all()
    assert (points >= lower + margin - 1e-5).all()
