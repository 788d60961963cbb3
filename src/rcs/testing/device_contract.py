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

    @contextmanager
    def open_device(self) -> Generator[D]:
        """Give an open device and close it in the end."""
        with self.make_device() as device:
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

    def test_a_lost_link_is_a_fault(self) -> None:
        """It is found by measuring, and the device can be closed and used no more."""
        device = self.make_device()
        device.open()
        try:
            self.lose_link(device)
            with pytest.raises(DeviceFault):
                self.measure(device)
            assert device.fault != ""
            with pytest.raises(DeviceFault):
                self.use(device)
        finally:
            device.close()
        assert not device.is_open

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


class MotionContract(DeviceContract[D]):
    """Checks what arms, grippers and hands share: they move when they are told to, and stop."""

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

    def require_stopped(self, device: D, target: Any) -> None:
        """Check that the device has stopped on its way to a target."""
        self.advance(self.stopping_time)
        assert self.is_at_rest(device)
        assert not self.is_near(device, target)

    @contextmanager
    def moving_device(self) -> Generator[tuple[D, Any]]:
        """Give an open device that is under way, and its target."""
        with self.open_device() as device:
            target = self.target_of(device)
            self.command(device, target)
            assert not device.has_arrived()
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

    def test_nothing_moves_when_a_device_is_opened_and_sent_where_it_is(self) -> None:
        """Its first command is not special."""
        with self.open_device() as device:
            assert self.is_at_rest(device)
            before = self.position(device)
            self.use(device)
            self.advance(self.stopping_time)
            assert self.is_near(device, before)

    def test_a_device_reaches_its_target(self) -> None:
        """And says so then, and not before; there it stays."""
        with self.moving_device() as (device, target):
            self.move(device)
            assert self.is_near(device, target)
            assert self.is_at_rest(device)

    def test_bad_targets_are_refused_and_the_device_stays(self) -> None:
        """Whatever is wrong with them; the device can be used afterwards."""
        with self.open_device() as device:
            before, target = self.position(device), self.target_of(device)
            for bad in self.bad_targets(device):
                with pytest.raises(InvalidAction):
                    self.command(device, bad)
            for valid_for in (0.0, -1.0, math.nan):
                with pytest.raises(InvalidAction, match="valid for"):
                    self.command(device, target, valid_for)
            self.advance(self.stopping_time)
            assert self.is_near(device, before)
            assert device.fault == ""
            self.use(device)

    def test_hold_stops_a_motion(self) -> None:
        """Where the device is, not where it was going."""
        with self.moving_device() as (device, target):
            device.hold()
            self.require_stopped(device, target)
            assert device.has_arrived()

    def test_closing_stops_a_motion(self) -> None:
        """A device that is opened again does not go on to the old target."""
        with self.moving_device() as (device, target):
            device.close()
            self.advance(self.stopping_time)
            device.open()
            self.require_stopped(device, target)

    def test_a_fault_stops_a_motion_and_recover_does_not_resume_it(self) -> None:
        """The target from before the fault is forgotten, and the device still measures."""
        with self.moving_device() as (device, target):
            device.set_fault("stop")
            self.require_stopped(device, target)
            device.recover()
            self.require_stopped(device, target)

    def test_a_device_recovers_from_its_own_fault_state(self) -> None:
        """Also where it refused to hold in it; it stands still until the next command."""
        with self.moving_device() as (device, target):
            self.provoke_fault(device)
            assert device.fault != ""
            with pytest.raises(DeviceFault):
                self.command(device, target)
            device.recover()
            assert device.fault == ""
            self.require_stopped(device, target)
            self.use(device)

    def test_another_thread_stops_a_motion_with_all_others(self) -> None:
        """The device is in fault with the reason that was given."""
        with self.moving_device() as (device, target):
            in_a_thread(lambda: stop_all("a person came near"))
            assert device.fault == "a person came near"
            self.require_stopped(device, target)
            with pytest.raises(DeviceFault, match="a person came near"):
                self.command(device, target)
            device.recover()

    def test_a_command_ends_when_its_time_is_over(self) -> None:
        """The device holds by itself, without a fault, and takes the next command."""
        with self.open_device() as device:
            target = self.target_of(device)
            self.command(device, target, 0.03)
            for _ in range(math.ceil(self.time_limit / 0.005)):
                time.sleep(0.005)  # the host's time, whatever clock the device runs on
                if device.has_arrived():
                    break
            self.require_stopped(device, target)
            assert device.fault == ""
            self.use(device)

    def test_a_newer_command_is_not_ended_by_the_time_of_the_one_before(self) -> None:
        """A command without an end moves the device to its target."""
        with self.open_device() as device:
            target = self.target_of(device)
            self.command(device, self.position(device), 0.1)
            self.command(device, target)
            time.sleep(0.15)
            self.move(device)
            assert self.is_near(device, target)


def in_a_thread(call: Callable[[], None]) -> None:
    """Make a call from another thread, and raise here what it raises."""
    with ThreadPoolExecutor(1) as pool:
        pool.submit(call).result()
