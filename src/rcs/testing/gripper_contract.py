"""What every gripper must do, as tests."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager

import pytest

from rcs.devices import Gripper
from rcs.errors import DeviceFault, InvalidAction, WrongOrder
from rcs.testing.arm_contract import in_a_thread


class GripperContract:
    """Checks a gripper. Opens and closes it fully, with nothing between the fingers."""

    tolerance: float = 0.02
    """How close to its target an opening must come, and how far one at rest may move [1]."""
    time_limit: float = 5.0
    """How long opening or closing fully may take [s]."""
    tick: float = 0.02
    """How often the gripper is looked at while it moves [s]."""
    stopping_time: float = 0.3
    """How long the fingers may take to come to rest after `hold` [s]."""

    def make_gripper(self) -> Gripper:
        """Return a new gripper, not opened (connected). To be overridden."""
        raise NotImplementedError("override make_gripper and return a new gripper that is not opened")

    def advance(self, seconds: float) -> None:
        """Let time pass; override it for a gripper on a simulated clock."""
        time.sleep(seconds)

    def provoke_fault(self, gripper: Gripper) -> None:
        """Bring a connected gripper into its own fault state; override it where a test can.

        Many controllers refuse even to hold then.
        """
        gripper.set_fault("provoked")

    @contextmanager
    def open_gripper(self) -> Generator[Gripper]:
        """Give a connected gripper and close the connection in the end."""
        gripper = self.make_gripper()
        gripper.open()
        try:
            yield gripper
        finally:
            gripper.close()

    def move(self, gripper: Gripper, opening: float) -> None:
        """Command an opening and let time pass until the fingers have arrived; fails after `time_limit`."""
        gripper.command_opening(opening)
        for _ in range(math.ceil(self.time_limit / self.tick)):
            self.advance(self.tick)
            if gripper.has_arrived():
                return
        pytest.fail(f"the fingers have not arrived within {self.time_limit} s")

    def far_from(self, gripper: Gripper) -> float:
        """Return the end of the range that is farther from the present opening."""
        return 0.0 if gripper.state().opening > 0.5 else 1.0

    def require_rest(self, gripper: Gripper) -> None:
        """Check that the fingers do not move for a while."""
        before = gripper.state().opening
        self.advance(self.stopping_time)
        assert gripper.state().opening == pytest.approx(before, abs=self.tolerance)

    def test_a_gripper_is_closed_and_without_fault_when_it_is_made(self) -> None:
        """Making a gripper connects nothing."""
        gripper = self.make_gripper()
        assert not gripper.is_open
        assert gripper.fault == ""
        assert gripper.max_width > 0
        assert gripper.max_force > 0

    def test_nothing_moves_when_a_gripper_is_made_and_opened(self) -> None:
        """Nor when it is opened twice."""
        with self.open_gripper() as gripper:
            gripper.open()
            assert gripper.is_open
            self.require_rest(gripper)

    def test_a_closed_gripper_refuses_every_call(self) -> None:
        """Before it is opened, and after it was closed."""
        gripper = self.make_gripper()
        _require_wrong_order(gripper)
        gripper.open()
        gripper.close()
        assert not gripper.is_open
        _require_wrong_order(gripper)

    def test_closing_is_harmless_twice_and_before_opening(self) -> None:
        """As often as one likes."""
        gripper = self.make_gripper()
        gripper.close()
        gripper.open()
        gripper.close()
        gripper.close()
        assert not gripper.is_open

    def test_a_state_is_an_opening_from_0_to_1(self) -> None:
        """And its time does not run backwards."""
        with self.open_gripper() as gripper:
            first = gripper.state()
            self.advance(self.tick)
            second = gripper.state()
            for state in (first, second):
                assert -self.tolerance <= state.opening <= 1 + self.tolerance
                assert math.isfinite(state.force)
            assert second.time >= first.time

    @pytest.mark.parametrize("opening", [-0.01, 1.01, math.nan, math.inf, -math.inf])
    def test_a_bad_opening_is_refused_and_the_fingers_stay(self, opening: float) -> None:
        """The gripper can be used afterwards."""
        with self.open_gripper() as gripper:
            with pytest.raises(InvalidAction):
                gripper.command_opening(opening)
            self.require_rest(gripper)
            assert gripper.fault == ""
            gripper.command_opening(0.5)

    def test_fingers_reach_their_target(self) -> None:
        """Both ends of the range, and then they stand still."""
        with self.open_gripper() as gripper:
            for target in (self.far_from(gripper), 1.0 - self.far_from(gripper)):
                self.move(gripper, target)
                assert gripper.state().opening == pytest.approx(target, abs=self.tolerance)
                self.require_rest(gripper)

    def test_fingers_have_not_arrived_right_after_a_command(self) -> None:
        """Also before they have picked up speed."""
        with self.open_gripper() as gripper:
            gripper.command_opening(self.far_from(gripper))
            assert not gripper.has_arrived()

    def test_hold_stops_a_motion(self) -> None:
        """Where the fingers are, not where they were going."""
        with self.open_gripper() as gripper:
            target = self.far_from(gripper)
            gripper.command_opening(target)
            self.advance(self.tick)
            gripper.hold()
            self.advance(self.stopping_time)
            assert abs(gripper.state().opening - target) > self.tolerance
            assert gripper.has_arrived()
            self.require_rest(gripper)

    def test_closing_stops_a_motion(self) -> None:
        """A gripper that is opened again does not go on to the old target."""
        gripper = self.make_gripper()
        gripper.open()
        target = self.far_from(gripper)
        gripper.command_opening(target)
        self.advance(self.tick)
        gripper.close()
        self.advance(self.stopping_time)
        gripper.open()
        try:
            assert abs(gripper.state().opening - target) > self.tolerance
            self.require_rest(gripper)
        finally:
            gripper.close()

    def test_a_fault_stays_until_recover(self) -> None:
        """It keeps its first reason, refuses commands, and the motion does not resume."""
        with self.open_gripper() as gripper:
            target = self.far_from(gripper)
            gripper.command_opening(target)
            self.advance(self.tick)
            gripper.set_fault("the first reason")
            gripper.set_fault("another reason")
            for _ in range(2):
                with pytest.raises(DeviceFault, match="the first reason"):
                    gripper.command_opening(target)
            assert gripper.fault == "the first reason"
            gripper.hold()
            gripper.recover()
            assert gripper.fault == ""
            self.advance(self.stopping_time)
            assert abs(gripper.state().opening - target) > self.tolerance
            gripper.command_opening(target)

    def test_a_gripper_recovers_from_its_own_fault_state(self) -> None:
        """Also where it refused to hold in it; it stands still until the next command."""
        with self.open_gripper() as gripper:
            target = self.far_from(gripper)
            gripper.command_opening(target)
            self.advance(self.tick)
            self.provoke_fault(gripper)
            assert gripper.fault != ""
            with pytest.raises(DeviceFault):
                gripper.command_opening(target)
            gripper.recover()
            assert gripper.fault == ""
            self.advance(self.stopping_time)
            self.require_rest(gripper)
            assert abs(gripper.state().opening - target) > self.tolerance

    def test_another_thread_stops_a_gripper(self) -> None:
        """A watchdog reads and sets the fault while the gripper is in use."""
        with self.open_gripper() as gripper:
            target = self.far_from(gripper)
            gripper.command_opening(target)
            self.advance(self.tick)

            def watch() -> None:
                assert gripper.is_open
                assert gripper.fault == ""
                gripper.hold()
                gripper.set_fault("watchdog")

            in_a_thread(watch)
            assert gripper.fault == "watchdog"
            self.advance(self.stopping_time)
            self.require_rest(gripper)
            with pytest.raises(DeviceFault, match="watchdog"):
                gripper.command_opening(target)
            gripper.recover()


def _require_wrong_order(gripper: Gripper) -> None:
    calls: list[Callable[[], object]] = [
        gripper.state,
        gripper.has_arrived,
        gripper.hold,
        gripper.recover,
        lambda: gripper.command_opening(0.5),
    ]
    for call in calls:
        with pytest.raises(WrongOrder):
            call()
