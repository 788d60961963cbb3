"""What every arm must do, as tests."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.devices import Arm
from rcs.errors import DeviceFault, InvalidAction, WrongOrder

Joints = NDArray[np.float64]

BAD_TARGETS: dict[str, Callable[[Arm], Joints]] = {
    "one joint too few": lambda arm: _present(arm)[1:],
    "one joint too many": lambda arm: np.append(_present(arm), 0.0),
    "no joints": lambda arm: np.zeros(0),
    "not a number": lambda arm: _with_first(arm, math.nan),
    "infinite": lambda arm: _with_first(arm, math.inf),
    "minus infinite": lambda arm: _with_first(arm, -math.inf),
    "above the limits": lambda arm: _with_first(arm, float(arm.limits.joint_upper[0]) + 0.01),
    "below the limits": lambda arm: _with_first(arm, float(arm.limits.joint_lower[0]) - 0.01),
}
"""Targets that no arm may accept."""


class ArmContract:
    """Checks an arm. Moves it by `distance` at every joint, several times: clear its surroundings first."""

    distance: float = 0.1
    """How far every joint moves [rad], towards the middle of its limits."""
    tolerance: float = 2e-3
    """How close to its target an arm must come, and how far one that stands still may move [rad]."""
    speed_margin: float = 1.05
    """By which factor a measured speed may exceed the limit: measurements are noisy."""
    time_limit: float = 10.0
    """How long a motion by `distance` may take [s]."""
    tick: float = 0.01
    """How often the arm is looked at while it moves [s]."""
    stopping_time: float = 0.3
    """How long the arm may take to come to rest after `hold` [s]."""

    def make_arm(self) -> Arm:
        """Return a new arm, not opened. To be overridden."""
        raise NotImplementedError("override make_arm and return a new arm that is not opened")

    def advance(self, seconds: float) -> None:
        """Let time pass; override it for an arm on a simulated clock."""
        time.sleep(seconds)

    def provoke_fault(self, arm: Arm) -> None:
        """Bring an open arm into its own fault state; override it where a test can, as by a light push.

        Many controllers refuse even to hold then.
        """
        arm.set_fault("provoked")

    @contextmanager
    def open_arm(self) -> Generator[Arm]:
        """Give an open arm and close it in the end."""
        arm = self.make_arm()
        arm.open()
        try:
            yield arm
        finally:
            arm.close()

    def target_of(self, arm: Arm) -> Joints:
        """Return a target that is `distance` away from the present joints, towards the middle of the limits."""
        limits, joints = arm.limits, _present(arm)
        middle = (limits.joint_lower + limits.joint_upper) / 2
        return joints + np.where(joints < middle, self.distance, -self.distance)

    def require_rest(self, arm: Arm) -> None:
        """Check that the arm does not move for a while."""
        before = _present(arm)
        self.advance(self.stopping_time)
        np.testing.assert_allclose(_present(arm), before, rtol=0.0, atol=self.tolerance)

    def test_an_arm_is_closed_and_without_fault_when_it_is_made(self) -> None:
        """Making an arm connects nothing."""
        arm = self.make_arm()
        assert not arm.is_open
        assert arm.fault == ""
        assert arm.name != ""
        assert arm.dof == len(arm.limits.joint_lower) == len(arm.limits.joint_upper) == len(arm.limits.joint_velocity)

    def test_nothing_moves_when_an_arm_is_made_and_opened(self) -> None:
        """Nor when it is opened twice."""
        with self.open_arm() as arm:
            before = _present(arm)
            arm.open()
            assert arm.is_open
            self.advance(self.stopping_time)
            np.testing.assert_allclose(_present(arm), before, rtol=0.0, atol=self.tolerance)

    def test_a_closed_arm_refuses_every_call(self) -> None:
        """Before it is opened, and after it was closed."""
        arm = self.make_arm()
        _require_wrong_order(arm)
        arm.open()
        arm.close()
        assert not arm.is_open
        _require_wrong_order(arm)

    def test_closing_is_harmless_twice_and_before_opening(self) -> None:
        """As often as one likes."""
        arm = self.make_arm()
        arm.close()
        arm.open()
        arm.close()
        arm.close()
        assert not arm.is_open

    def test_a_state_has_a_finite_value_for_every_joint(self) -> None:
        """And its time does not run backwards."""
        with self.open_arm() as arm:
            first = arm.state()
            self.advance(self.tick)
            second = arm.state()
            for state in (first, second):
                assert state.joints.shape == state.joint_velocities.shape == (arm.dof,)
                assert np.isfinite(state.joints).all()
                assert np.isfinite(state.joint_velocities).all()
            assert second.time >= first.time

    def test_writing_to_a_measurement_changes_nothing(self) -> None:
        """Measurements are copies."""
        with self.open_arm() as arm:
            before = _present(arm)
            arm.state().joints[:] = 9.0
            np.testing.assert_allclose(_present(arm), before, rtol=0.0, atol=self.tolerance)

    @pytest.mark.parametrize("kind", BAD_TARGETS)
    def test_a_bad_target_is_refused_and_the_arm_stays(self, kind: str) -> None:
        """Whatever is wrong with it; the arm can be used afterwards."""
        with self.open_arm() as arm:
            before = _present(arm)
            with pytest.raises(InvalidAction):
                arm.command_joints(BAD_TARGETS[kind](arm))
            self.advance(self.stopping_time)
            np.testing.assert_allclose(_present(arm), before, rtol=0.0, atol=self.tolerance)
            assert arm.fault == ""
            arm.command_joints(before)

    def test_an_arm_reaches_its_target_within_its_velocity_limits(self) -> None:
        """And says so then, and not before."""
        with self.open_arm() as arm:
            target = self.target_of(arm)
            arm.command_joints(target)
            assert not arm.has_arrived()
            limit = arm.limits.joint_velocity * self.speed_margin
            for _ in range(math.ceil(self.time_limit / self.tick)):
                self.advance(self.tick)
                assert (np.abs(arm.state().joint_velocities) <= limit).all()
                if arm.has_arrived():
                    break
            assert arm.has_arrived()
            np.testing.assert_allclose(_present(arm), target, rtol=0.0, atol=self.tolerance)
            self.require_rest(arm)

    def test_hold_stops_a_motion(self) -> None:
        """Where the arm is, not where it was going."""
        with self.open_arm() as arm:
            target = self.target_of(arm)
            arm.command_joints(target)
            self.advance(self.tick)
            arm.hold()
            self.advance(self.stopping_time)
            assert np.abs(_present(arm) - target).max() > self.tolerance
            assert arm.has_arrived()
            self.require_rest(arm)

    def test_closing_stops_a_motion(self) -> None:
        """An arm that is opened again does not go on to the old target."""
        arm = self.make_arm()
        arm.open()
        target = self.target_of(arm)
        arm.command_joints(target)
        self.advance(self.tick)
        arm.close()
        self.advance(self.stopping_time)
        arm.open()
        try:
            assert np.abs(_present(arm) - target).max() > self.tolerance
            self.require_rest(arm)
        finally:
            arm.close()

    def test_a_fault_stays_until_recover(self) -> None:
        """It keeps its first reason, refuses commands, and still measures and holds."""
        with self.open_arm() as arm:
            before = _present(arm)
            arm.set_fault("the first reason")
            arm.set_fault("another reason")
            for _ in range(2):
                with pytest.raises(DeviceFault, match="the first reason"):
                    arm.command_joints(before)
            assert arm.fault == "the first reason"
            assert np.isfinite(arm.state().joints).all()
            arm.hold()
            arm.recover()
            assert arm.fault == ""
            arm.command_joints(before)

    def test_a_fault_stops_a_motion_and_recover_does_not_resume_it(self) -> None:
        """The target from before the fault is forgotten."""
        with self.open_arm() as arm:
            target = self.target_of(arm)
            arm.command_joints(target)
            self.advance(self.tick)
            arm.set_fault("stop")
            self.advance(self.stopping_time)
            self.require_rest(arm)
            arm.recover()
            self.require_rest(arm)
            assert np.abs(_present(arm) - target).max() > self.tolerance

    def test_an_arm_recovers_from_its_own_fault_state(self) -> None:
        """Also where it refused to hold in it; it stands still until the next command."""
        with self.open_arm() as arm:
            target = self.target_of(arm)
            arm.command_joints(target)
            self.advance(self.tick)
            self.provoke_fault(arm)
            assert arm.fault != ""
            with pytest.raises(DeviceFault):
                arm.command_joints(target)
            arm.recover()
            assert arm.fault == ""
            self.advance(self.stopping_time)
            self.require_rest(arm)
            assert np.abs(_present(arm) - target).max() > self.tolerance
            arm.command_joints(_present(arm))

    def test_another_thread_stops_an_arm(self) -> None:
        """A watchdog reads and sets the fault while the arm is in use."""
        with self.open_arm() as arm:
            target = self.target_of(arm)
            arm.command_joints(target)
            self.advance(self.tick)

            def watch() -> None:
                assert arm.is_open
                assert arm.fault == ""
                arm.hold()
                arm.set_fault("watchdog")

            in_a_thread(watch)
            assert arm.fault == "watchdog"
            self.advance(self.stopping_time)
            self.require_rest(arm)
            with pytest.raises(DeviceFault, match="watchdog"):
                arm.command_joints(target)
            arm.recover()


def in_a_thread(call: Callable[[], None]) -> None:
    """Make a call from another thread, and raise here what it raises."""
    with ThreadPoolExecutor(1) as pool:
        pool.submit(call).result()


def _present(arm: Arm) -> Joints:
    return np.array(arm.state().joints)


def _with_first(arm: Arm, value: float) -> Joints:
    joints = _present(arm)
    joints[0] = value
    return joints


def _require_wrong_order(arm: Arm) -> None:
    calls: list[Callable[[], object]] = [
        arm.state,
        arm.has_arrived,
        arm.hold,
        arm.recover,
        lambda: arm.command_joints((arm.limits.joint_lower + arm.limits.joint_upper) / 2),
    ]
    for call in calls:
        with pytest.raises(WrongOrder):
            call()
