"""The contract of devices that move, as tests: first commands, targets, and times to live."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import pytest

from rcs.devices.fakes import FakeGripper
from rcs.errors import InvalidAction
from rcs.testing.device_contract import D, in_a_thread
from rcs.testing.stopping_contract import StoppingContract


class MotionContract(StoppingContract[D]):
    """Checks what arms, grippers and hands share: they move when they are commanded to, and stop.

    Where a busy machine stops a device so late that it may have arrived, a test that notices this is skipped.
    """

    # --- Before the first command -------------------------------------------------------------------------------------

    def test_opening_energises_and_moves_nothing(self) -> None:
        """It reads. The first command energises, from the measured state; closing takes the power away again."""
        with self.open_device() as device:
            assert self.is_at_rest(device)
            assert not self.is_energised(device)
            device.hold()
            assert not self.is_energised(device)
            before = self.position(device)
            self.use(device)
            assert self.is_energised(device) in (True, None)
            self.advance(self.stopping_time)
            assert self.is_near(device, before)
            device.close()
            device.open()
            assert not self.is_energised(device)

    def test_nothing_moves_when_a_device_is_opened_and_sent_where_it_is(self) -> None:
        """Its first command is not special."""
        with self.staying_device() as device:
            assert self.is_at_rest(device)
            self.use(device)

    def test_hold_before_the_first_command_moves_nothing(self) -> None:
        """From any thread, and twice."""
        with self.staying_device() as device:
            device.hold()
            in_a_thread(device.hold)

    def test_recover_and_opening_again_move_nothing(self) -> None:
        """With a fault and without."""
        with self.staying_device() as device:
            device.recover()
            device.set_fault("stop")
            device.recover()
            device.close()
            device.open()

    def test_a_device_that_was_sent_nowhere_has_arrived(self) -> None:
        """It stands still, and has nowhere to go."""
        with self.open_device() as device:
            self.advance(self.stopping_time)
            assert device.has_arrived()

    # --- Targets ------------------------------------------------------------------------------------------------------

    def test_a_device_reaches_its_target(self) -> None:
        """And says so then, and not before; there it stays."""
        with self.moving_device() as (device, target):
            self.require_reached(device, target)
            assert self.is_at_rest(device)

    def test_the_same_target_again_is_harmless(self) -> None:
        """Under way and at rest."""
        with self.moving_device() as (device, target):
            for _ in range(3):
                self.command(device, target)
                self.advance(self.tick)
            self.require_reached(device, target)
            self.command(device, target)
            self.require_reached(device, target)

    def test_a_newer_target_takes_the_place_of_the_one_before(self) -> None:
        """The device turns round on its way."""
        with self.open_device() as device:
            start, target = self.position(device), self.target_of(device)
            self.command(device, target)
            self.advance(self.tick)
            self.command(device, start)
            self.require_reached(device, start)
            assert self.is_at_rest(device)

    def test_bad_targets_are_refused_and_the_device_stays(self) -> None:
        """Whatever is wrong with them; the error names the device, which can be used afterwards."""
        with self.staying_device() as device:
            for bad in self.bad_targets(device):
                with pytest.raises(InvalidAction) as caught:
                    self.command(device, bad)
                assert device.name in str(caught.value)
            self.advance(self.stopping_time)
            assert device.fault == ""
            self.use(device)

    def test_what_is_no_target_is_refused_and_the_device_stays(self) -> None:
        """None, a text, a table."""
        with self.staying_device() as device:
            for bad in (None, "far", [[0.0]], {}, 1j):
                with pytest.raises((InvalidAction, TypeError)):
                    self.command(device, bad)

    def test_bad_targets_leave_a_motion_as_it_is(self) -> None:
        """A refused command changes nothing: the device goes on to the target of the one before."""
        with self.moving_device() as (device, target):
            for bad in self.bad_targets(device):
                with pytest.raises(InvalidAction):
                    self.command(device, bad)
            self.require_reached(device, target)

    # --- Time to live -------------------------------------------------------------------------------------------------

    def test_a_time_to_live_is_more_than_nothing(self) -> None:
        """Anything else is refused, and the device stays."""
        with self.staying_device() as device:
            target = self.target_of(device)
            for valid_for in (0.0, -1.0, -math.inf, math.nan):
                with pytest.raises(InvalidAction, match="valid for"):
                    self.command(device, target, valid_for)

    def test_a_command_ends_when_its_time_is_over(self) -> None:
        """The device holds by itself, without a fault, and takes the next command.

        A machine that is busy holds it late. How late is seen by a stopwatch, whose command ends next; a device that
        may have arrived by then is sent once more.
        """
        with self.open_device() as device, Stopwatch() as stopwatch:
            target: Any = None
            for _ in range(5):
                stopwatch.held = math.nan
                target = self.target_of(device)
                self.begin(device, target, 0.03)
                stopwatch.command_opening(0.0, valid_for=0.03)
                self.stop(lambda: wait_until(lambda: not math.isnan(stopwatch.held)))
                self._stopped = stopwatch.held
                time.sleep(0.1)  # a thread of its own holds each of the two: that of the device may come second
                if not self.may_have_arrived:
                    break
                self.advance(self.stopping_time)
            self.require_stopped(device, target)
            assert device.fault == ""
            assert device.has_arrived()
            self.use(device)

    def test_a_late_command_goes_on_from_where_the_device_was_held(self) -> None:
        """A gap in a stream costs time and nothing else."""
        with self.open_device() as device:
            target = self.target_of(device)
            self.command(device, target, 0.01)
            time.sleep(0.05)
            self.advance(self.stopping_time)
            assert self.is_at_rest(device)
            self.command(device, target)
            self.require_reached(device, target)
            assert device.fault == ""

    def test_a_stream_of_short_commands_goes_on_to_its_target(self) -> None:
        """Each takes the place of the one before in time."""
        with self.open_device() as device:
            target = self.target_of(device)
            for _ in range(math.ceil(self.time_limit / self.tick)):
                self.command(device, target, 5.0)
                self.advance(self.tick)
                if self.is_near(device, target):
                    break
            self.require_reached(device, target)
            assert device.fault == ""

    def test_a_newer_command_is_not_ended_by_the_time_of_the_one_before(self) -> None:
        """A command without an end moves the device to its target, and so does one with a later end."""
        with self.open_device() as device:
            start, target = self.position(device), self.target_of(device)
            for there, valid_for in ((target, math.inf), (start, self.time_limit)):
                self.command(device, self.position(device), 0.1)
                self.command(device, there, valid_for)
                time.sleep(0.15)
                self.require_reached(device, there)


class Stopwatch(FakeGripper):
    """Notes when it is held, for a device that was commanded just before it for the same time."""

    held: float = math.nan

    def _hold(self) -> None:
        self.held = time.monotonic()


def wait_until(is_so: Callable[[], bool]) -> None:
    """Wait until something is so; fails after a time in which it must be."""
    for _ in range(5000):
        if is_so():
            return
        time.sleep(0.002)
    pytest.fail("it has not come within 10 s")
