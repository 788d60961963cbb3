"""What every device must do, as tests: its life from `open` to `close`, faults, and stops from elsewhere."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

import pytest

from rcs.devices import Device, stop_all
from rcs.errors import DeviceFault, InvalidAction, WrongOrder

D = TypeVar("D", bound=Device)


class DeviceContract(Generic[D]):
    """Checks what arms, grippers, hands and cameras share. Subclass the contract of yours, not this one."""

    max_age: float = 0.5
    """How old a measurement may be when it is given [s]."""

    def make_device(self) -> D:
        """Return a new device, not opened."""
        raise NotImplementedError

    def measure(self, device: D) -> Any:
        """Return what the device measures now, with its times."""
        raise NotImplementedError

    def use(self, device: D) -> None:
        """Make a call that is refused in the fault state and moves nothing."""
        self.measure(device)

    def advance(self, seconds: float) -> None:
        """Let time pass; override it for a device on a simulated clock."""
        time.sleep(seconds)

    def provoke_fault(self, device: D) -> None:
        """Bring an open device into its own fault state; override it where a test can, as by a light push.

        Many controllers refuse even to hold then.
        """
        device.set_fault("provoked")

    def lose_link(self, device: D) -> None:
        """Cut the connection to an open device; override it where a test can."""
        pytest.skip("override lose_link to test the loss of the link")

    def restore_link(self, device: D) -> None:
        """Mend the connection again; override it where a test can."""
        pytest.skip("override restore_link to test what follows when the link is back")

    def is_energised(self, device: D) -> bool | None:
        """Return whether the motors of an open device have power; override it where a test can tell. None if not."""
        return None

    @contextmanager
    def open_device(self) -> Generator[D]:
        """Give an open device and close it in the end."""
        with self.make_device() as device:
            yield device

    @contextmanager
    def lost_device(self) -> Generator[D]:
        """Give an open device whose link is lost, which is known."""
        with self.open_device() as device:
            self.lose_link(device)
            with pytest.raises(DeviceFault):
                self.measure(device)
            yield device

    def require_closed(self, device: D) -> None:
        """Check that the device refuses every call."""
        assert not device.is_open
        calls: list[Callable[[], object]] = [
            lambda: self.measure(device),
            lambda: self.use(device),
            device.has_arrived,
            device.hold,
            device.recover,
            lambda: device.guide(True),
        ]
        for call in calls:
            with pytest.raises(WrongOrder):
                call()

    # --- Open and close -----------------------------------------------------------------------------------------------

    def test_a_device_is_closed_and_without_fault_when_it_is_made(self) -> None:
        """Making it connects nothing, and before it is opened and after it was closed it refuses every call."""
        device = self.make_device()
        assert device.name != ""
        assert device.fault == ""
        self.require_closed(device)
        device.open()
        device.close()
        self.require_closed(device)

    def test_opening_and_closing_are_harmless_twice(self) -> None:
        """As often as one likes, and closing before opening."""
        device = self.make_device()
        device.close()
        device.open()
        device.open()
        assert device.is_open
        self.measure(device)
        device.close()
        device.close()
        assert not device.is_open

    def test_a_device_is_opened_again_and_again(self) -> None:
        """Closing leaves nothing behind that opening stumbles over."""
        device = self.make_device()
        for _ in range(3):
            with device:
                self.measure(device)
                self.use(device)
            assert device.fault == ""

    def test_a_device_is_a_context_manager(self) -> None:
        """It is open inside, and closed whatever is raised."""
        device = self.make_device()
        with device as same:
            assert same is device
            assert device.is_open
        assert not device.is_open
        with pytest.raises(ZeroDivisionError), device:
            _ = 1 / 0
        assert not device.is_open

    def test_a_measurement_has_the_time_of_the_host(self) -> None:
        """Its own clock, where it has one, does not run backwards."""
        with self.open_device() as device:
            begin = time.monotonic()
            first = self.measure(device)
            self.advance(0.05)
            second = self.measure(device)
            assert begin - self.max_age <= first.time <= second.time <= time.monotonic()
            assert math.isnan(first.device_time) or second.device_time >= first.device_time

    # --- Faults -------------------------------------------------------------------------------------------------------

    def test_a_fault_keeps_its_first_reason_until_recover(self) -> None:
        """Nothing can be done with the device meanwhile but to hold it."""
        with self.open_device() as device:
            device.set_fault("the first reason")
            device.set_fault("another reason")
            for _ in range(2):
                with pytest.raises(DeviceFault, match="the first reason"):
                    self.use(device)
            assert device.fault == "the first reason"
            device.hold()
            device.recover()
            assert device.fault == ""
            self.use(device)

    def test_a_fault_without_a_reason_is_one(self) -> None:
        """An empty text would mean that there is none."""
        with self.open_device() as device:
            device.set_fault("")
            assert device.fault != ""
            with pytest.raises(DeviceFault):
                self.use(device)
            device.recover()

    def test_recover_without_a_fault_is_harmless(self) -> None:
        """As often as one likes."""
        with self.open_device() as device:
            device.recover()
            device.recover()
            assert device.fault == ""
            self.use(device)

    def test_a_fault_of_a_closed_device_is_met_when_it_is_open(self) -> None:
        """Opening clears nothing: only `recover` does."""
        device = self.make_device()
        device.set_fault("it was dropped")
        with device:
            with pytest.raises(DeviceFault, match="it was dropped"):
                self.use(device)
            device.recover()
            self.use(device)

    def test_a_device_in_fault_is_closed_without_an_error(self) -> None:
        """Whether it can be held or not: its fault is known."""
        device = self.make_device()
        device.open()
        self.provoke_fault(device)
        fault = device.fault
        device.close()
        self.require_closed(device)
        assert device.fault == fault
        with device:
            device.recover()
            self.use(device)

    def test_faults_from_many_threads_are_one(self) -> None:
        """The first that comes."""
        with self.open_device() as device, ThreadPoolExecutor(4) as pool:
            reasons = [f"reason {i}" for i in range(8)]
            list(pool.map(device.set_fault, reasons))
            assert device.fault in reasons
            device.recover()
            assert device.fault == ""

    def test_another_thread_stops_a_device(self) -> None:
        """A watchdog reads and sets the fault and holds while the device is in use."""
        with self.open_device() as device:

            def watch() -> None:
                assert device.is_open
                assert device.fault == ""
                device.hold()
                device.set_fault("watchdog")

            in_a_thread(watch)
            assert device.fault == "watchdog"
            with pytest.raises(DeviceFault, match="watchdog"):
                self.use(device)
            device.recover()
            self.use(device)

    # --- The link -----------------------------------------------------------------------------------------------------

    def test_a_lost_link_is_a_fault(self) -> None:
        """It is found by measuring, the error names the device, and the device can be used no more."""
        with self.open_device() as device:
            self.lose_link(device)
            with pytest.raises(DeviceFault) as caught:
                self.measure(device)
            assert device.name in str(caught.value)
            assert device.fault != ""
            with pytest.raises(DeviceFault):
                self.use(device)

    def test_a_device_whose_link_is_lost_is_closed_without_an_error(self) -> None:
        """Its fault is known, so that leaving a `with` block raises nothing."""
        with self.lost_device() as device:
            fault = device.fault
        assert not device.is_open
        assert device.fault == fault

    def test_a_device_cannot_recover_without_its_link(self) -> None:
        """The fault stays."""
        with self.lost_device() as device:
            with pytest.raises(DeviceFault, match="recover failed"):
                device.recover()
            assert device.fault != ""
            with pytest.raises(DeviceFault):
                self.use(device)

    def test_a_device_cannot_be_opened_without_its_link(self) -> None:
        """It stays closed, and opens when the link is back."""
        with self.lost_device() as device:
            pass
        with pytest.raises(DeviceFault) as caught:
            device.open()
        assert device.name in str(caught.value)
        self.require_closed(device)
        device.close()
        self.restore_link(device)
        with device:
            device.recover()
            self.use(device)

    def test_a_device_whose_link_is_back_recovers(self) -> None:
        """Not by itself."""
        with self.lost_device() as device:
            self.restore_link(device)
            with pytest.raises(DeviceFault):
                self.use(device)
            device.recover()
            assert device.fault == ""
            self.measure(device)
            self.use(device)

    # --- Guiding by hand ----------------------------------------------------------------------------------------------

    def test_a_person_guides_a_device_only_where_it_says_so(self) -> None:
        """While it is guided, nothing else moves it; hold ends it."""
        with self.open_device() as device:
            if not device.can_guide:
                with pytest.raises(InvalidAction, match="cannot be guided"):
                    device.guide(True)
                assert not device.is_guided
                return
            device.guide(True)
            assert device.is_guided
            with pytest.raises(WrongOrder, match="guide"):
                self.use(device)
            device.hold()
            assert not device.is_guided
            self.use(device)

    def test_a_fault_and_closing_end_guiding(self) -> None:
        """And a device in fault cannot be guided, if it ever can."""
        device = self.make_device()
        with device:
            if device.can_guide:
                device.guide(True)
            device.set_fault("stop")
            assert not device.is_guided
            with pytest.raises(DeviceFault, match="stop"):
                device.guide(True)
            device.recover()
            if device.can_guide:
                device.guide(True)
        assert not device.is_guided
        with device:
            assert not device.is_guided
            self.use(device)


class MotionContract(DeviceContract[D]):
    """Checks what arms, grippers and hands share: they move when they are told to, and stop.

    Where a busy machine stops a device so late that it may have arrived, a test that says so is skipped.
    """

    tolerance: float
    """How close to its target a device must come, and how far one at rest may move."""
    time_limit: float = 10.0
    """How long a motion to the target may take [s]."""
    tick: float = 0.01
    """How often the device is looked at while it moves [s]."""
    stopping_time: float = 0.3
    """How long the device may take to come to rest after `hold` [s]."""

    def position(self, device: D) -> Any:
        """Return where the device is."""
        raise NotImplementedError

    def command(self, device: D, target: Any, valid_for: float = math.inf) -> None:
        """Send it somewhere."""
        raise NotImplementedError

    def target_of(self, device: D) -> Any:
        """Return a target far enough that the device is under way for some ticks."""
        raise NotImplementedError

    def bad_targets(self, device: D) -> list[Any]:
        """Return targets that the device must refuse."""
        raise NotImplementedError

    def least_time(self, device: D, target: Any) -> float:
        """Return a time within which no device gets to a target [s]."""
        return 0.05

    def use(self, device: D) -> None:
        """Send the device where it is."""
        self.command(device, self.position(device))

    def is_near(self, device: D, target: Any) -> bool:
        """Return whether the device is at a target."""
        return self.position(device) == pytest.approx(target, rel=0.0, abs=self.tolerance)

    def is_at_rest(self, device: D) -> bool:
        """Return whether the device does not move for a while."""
        before = self.position(device)
        self.advance(self.stopping_time)
        return self.is_near(device, before)

    def begin(self, device: D, target: Any, valid_for: float = math.inf) -> None:
        """Send a device on its way, which takes it a while."""
        self._least_time = self.least_time(device, target)
        self._began = time.monotonic()
        self.command(device, target, valid_for)

    def stop(self, call: Callable[[], object]) -> None:
        """Stop a device that was sent on its way."""
        call()
        self._stopped = time.monotonic()

    @property
    def may_have_arrived(self) -> bool:
        """Whether the stop came so late that the device may have been at its target before."""
        return self._stopped - self._began >= self._least_time

    def require_stopped(self, device: D, target: Any) -> None:
        """Check that the device has come to rest on its way to a target."""
        self.advance(self.stopping_time)
        assert self.is_at_rest(device)
        if self.is_near(device, target) and self.may_have_arrived:
            pytest.skip("the machine is too busy to stop the device on its way")
        assert not self.is_near(device, target)

    @contextmanager
    def moving_device(self) -> Generator[tuple[D, Any]]:
        """Give an open device that is under way, and its target."""
        with self.open_device() as device:
            target = self.target_of(device)
            self.begin(device, target)
            has_arrived = device.has_arrived()
            self.stop(lambda: None)
            if has_arrived and self.may_have_arrived:
                pytest.skip("the machine is too busy to see the device on its way")
            assert not has_arrived
            self.advance(self.tick)
            yield device, target

    def move(self, device: D) -> None:
        """Let time pass until the device has arrived; fails after `time_limit`."""
        for _ in range(math.ceil(self.time_limit / self.tick)):
            if device.has_arrived():
                return
            self.advance(self.tick)
            self.look_while_moving(device)
        pytest.fail(f"the device has not arrived within {self.time_limit} s")

    def look_while_moving(self, device: D) -> None:
        """Check something at every tick of a motion."""

    def require_reached(self, device: D, target: Any) -> None:
        """Check that the device comes to a target."""
        self.move(device)
        assert self.is_near(device, target)

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
        with self.open_device() as device:
            assert self.is_at_rest(device)
            before = self.position(device)
            self.use(device)
            self.advance(self.stopping_time)
            assert self.is_near(device, before)

    def test_hold_before_the_first_command_moves_nothing(self) -> None:
        """From any thread, and twice."""
        with self.open_device() as device:
            before = self.position(device)
            device.hold()
            in_a_thread(device.hold)
            self.advance(self.stopping_time)
            assert self.is_near(device, before)
            assert device.fault == ""

    def test_recover_and_opening_again_move_nothing(self) -> None:
        """With a fault and without."""
        with self.open_device() as device:
            before = self.position(device)
            device.recover()
            device.set_fault("stop")
            device.recover()
            device.close()
            device.open()
            self.advance(self.stopping_time)
            assert self.is_near(device, before)

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
        with self.open_device() as device:
            before = self.position(device)
            for bad in self.bad_targets(device):
                with pytest.raises(InvalidAction) as caught:
                    self.command(device, bad)
                assert device.name in str(caught.value)
            self.advance(self.stopping_time)
            assert self.is_near(device, before)
            assert device.fault == ""
            self.use(device)

    def test_what_is_no_target_is_refused_and_the_device_stays(self) -> None:
        """None, a text, a table."""
        with self.open_device() as device:
            before = self.position(device)
            for bad in (None, "far", [[0.0]], {}, 1j):
                with pytest.raises((InvalidAction, TypeError)):
                    self.command(device, bad)
            self.advance(self.stopping_time)
            assert self.is_near(device, before)
            assert device.fault == ""

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
        with self.open_device() as device:
            before, target = self.position(device), self.target_of(device)
            for valid_for in (0.0, -1.0, -math.inf, math.nan):
                with pytest.raises(InvalidAction, match="valid for"):
                    self.command(device, target, valid_for)
            self.advance(self.stopping_time)
            assert self.is_near(device, before)
            assert device.fault == ""

    def test_a_command_ends_when_its_time_is_over(self) -> None:
        """The device holds by itself, without a fault, and takes the next command.

        A machine that is busy holds it late. How late is seen by a stopwatch, which is held after it; a device that may
        have arrived by then is sent once more.
        """
        from rcs.devices.fakes import FakeGripper

        class Stopwatch(FakeGripper):
            held = math.nan

            def _hold(self) -> None:
                self.held = time.monotonic()

        with self.open_device() as device, Stopwatch() as stopwatch:
            for _ in range(5):
                stopwatch.held = math.nan
                target = self.target_of(device)
                self.begin(device, target, 0.03)
                stopwatch.command_opening(0.0, valid_for=0.03)
                self.stop(lambda: wait_until(lambda: not math.isnan(stopwatch.held)))
                self._stopped = stopwatch.held
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
        """A command without an end moves the device to its target."""
        with self.open_device() as device:
            target = self.target_of(device)
            self.command(device, self.position(device), 0.1)
            self.command(device, target)
            time.sleep(0.15)
            self.require_reached(device, target)

    # --- Hold ---------------------------------------------------------------------------------------------------------

    def test_hold_stops_a_motion(self) -> None:
        """Where the device is, not where it was going."""
        with self.moving_device() as (device, target):
            self.stop(device.hold)
            self.require_stopped(device, target)
            assert device.has_arrived()

    def test_another_thread_holds_a_motion(self) -> None:
        """Several at once; that is no fault."""
        with self.moving_device() as (device, target), ThreadPoolExecutor(4) as pool:
            self.stop(lambda: [call.result() for call in [pool.submit(device.hold) for _ in range(8)]])
            self.require_stopped(device, target)
            assert device.fault == ""

    def test_a_device_goes_on_with_the_next_command_after_hold(self) -> None:
        """To the end."""
        with self.moving_device() as (device, target):
            device.hold()
            self.advance(self.tick)
            self.command(device, target)
            self.require_reached(device, target)

    def test_hold_at_rest_moves_nothing(self) -> None:
        """At a target, and twice."""
        with self.moving_device() as (device, target):
            self.move(device)
            device.hold()
            device.hold()
            self.advance(self.stopping_time)
            assert self.is_near(device, target)
            assert device.has_arrived()

    def test_closing_stops_a_motion(self) -> None:
        """A device that is opened again does not go on to the old target."""
        with self.moving_device() as (device, target):
            self.stop(device.close)
            self.advance(self.stopping_time)
            device.open()
            self.require_stopped(device, target)

    # --- Faults in motion ---------------------------------------------------------------------------------------------

    def test_a_fault_stops_a_motion_and_recover_does_not_resume_it(self) -> None:
        """The target from before the fault is forgotten, and the device still measures."""
        with self.moving_device() as (device, target):
            self.stop(lambda: device.set_fault("stop"))
            self.require_stopped(device, target)
            device.recover()
            self.require_stopped(device, target)

    def test_commands_in_fault_are_refused_and_move_nothing(self) -> None:
        """Those with a time to live too."""
        with self.moving_device() as (device, target):
            self.stop(lambda: device.set_fault("stop"))
            for valid_for in (math.inf, 0.05):
                with pytest.raises(DeviceFault, match="stop"):
                    self.command(device, target, valid_for)
            self.require_stopped(device, target)
            assert device.fault == "stop"

    def test_the_first_command_after_recover_counts(self) -> None:
        """From where the device is then."""
        with self.moving_device() as (device, target):
            device.set_fault("stop")
            device.recover()
            self.command(device, target)
            self.require_reached(device, target)

    def test_a_device_recovers_from_its_own_fault_state(self) -> None:
        """Also where it refused to hold in it; it stands still until the next command."""
        with self.moving_device() as (device, target):
            self.stop(lambda: self.provoke_fault(device))
            assert device.fault != ""
            with pytest.raises(DeviceFault):
                self.command(device, target)
            device.recover()
            assert device.fault == ""
            self.require_stopped(device, target)
            self.use(device)

    def test_closing_in_fault_leaves_nothing_to_resume(self) -> None:
        """Nor does opening and recovering afterwards."""
        with self.moving_device() as (device, target):
            self.stop(lambda: self.provoke_fault(device))
            device.close()
            device.open()
            device.recover()
            self.require_stopped(device, target)

    def test_a_thread_that_commands_meets_the_fault(self) -> None:
        """At its next command at the latest; the device has stopped."""
        with self.open_device() as device, ThreadPoolExecutor(1) as pool:
            target = self.target_of(device)
            self.begin(device, target)

            def command_on() -> None:
                while True:
                    self.command(device, target, 1.0)

            commanding = pool.submit(command_on)
            self.advance(self.tick)
            self.stop(lambda: device.set_fault("watchdog"))
            with pytest.raises(DeviceFault, match="watchdog"):
                commanding.result(timeout=self.time_limit)
            self.require_stopped(device, target)

    def test_another_thread_stops_a_motion_with_all_others(self) -> None:
        """The device is in fault with the reason that was given first."""
        with self.moving_device() as (device, target):
            self.stop(lambda: in_a_thread(lambda: stop_all("a person came near")))
            stop_all("another one")
            assert device.fault == "a person came near"
            self.require_stopped(device, target)
            with pytest.raises(DeviceFault, match="a person came near"):
                self.command(device, target)
            device.recover()

    def test_a_stop_of_all_leaves_closed_devices_alone(self) -> None:
        """Before they are opened, and after."""
        device = self.make_device()
        stop_all("a person came near")
        with device:
            self.use(device)
        stop_all("a person came near")
        assert device.fault == ""

    # --- The link in motion -------------------------------------------------------------------------------------------

    def test_a_command_without_a_link_is_a_fault(self) -> None:
        """The device has taken no target."""
        with self.open_device() as device:
            target = self.target_of(device)
            self.lose_link(device)
            with pytest.raises(DeviceFault) as caught:
                self.command(device, target)
            assert device.name in str(caught.value)
            assert device.fault != ""

    def test_a_hold_without_a_link_is_a_fault(self) -> None:
        """Nobody may believe that the device was told."""
        with self.open_device() as device:
            self.lose_link(device)
            with pytest.raises(DeviceFault) as caught:
                device.hold()
            assert device.name in str(caught.value)
            assert device.fault != ""

    def test_a_motion_in_which_the_link_was_lost_is_not_resumed(self) -> None:
        """Neither when the link is back nor by `recover`."""
        with self.moving_device() as (device, target):
            self.stop(lambda: self.lose_link(device))
            with pytest.raises(DeviceFault):
                self.measure(device)
            self.restore_link(device)
            device.recover()
            self.require_stopped(device, target)
            self.command(device, target)
            self.require_reached(device, target)


def in_a_thread(call: Callable[[], None]) -> None:
    """Make a call from another thread, and raise here what it raises."""
    with ThreadPoolExecutor(1) as pool:
        pool.submit(call).result()


def wait_until(is_so: Callable[[], bool]) -> None:
    """Wait until something is so; fails after a time in which it must be."""
    for _ in range(5000):
        if is_so():
            return
        time.sleep(0.002)
    pytest.fail("it has not come within 10 s")
