"""The contract of devices that move: hold, faults, stops from other threads, and lost links in motion."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import pytest

from rcs.devices import stop_all
from rcs.errors import DeviceFault
from rcs.testing.device_contract import D, DeviceContract, in_a_thread


class StoppingContract(DeviceContract[D]):
    """Checks that a device that moves can be stopped, and stays stopped."""

    tolerance: float
    """Largest distance from its target on arrival, and largest motion at rest."""
    time_limit: float = 10.0
    """How long a motion to the target may take [s]."""
    tick: float = 0.01
    """Period of checks while the device moves [s]."""
    stopping_time: float = 0.3
    """How long the device may take to come to rest after `hold` [s]."""

    def position(self, device: D) -> Any:
        """Return the position of the device."""
        raise NotImplementedError

    def command(self, device: D, target: Any, valid_for: float = math.inf) -> None:
        """Send the device to a target."""
        raise NotImplementedError

    def target_of(self, device: D) -> Any:
        """Return a target far enough that the device is under way for some ticks."""
        raise NotImplementedError

    def bad_targets(self, device: D) -> list[Any]:
        """Return targets that the device must refuse."""
        raise NotImplementedError

    def least_time(self, device: D, target: Any) -> float:
        """Return a time in which no device can reach a target [s]."""
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
    def staying_device(self) -> Generator[D]:
        """Give an open device, and check that nothing in the block has moved it or brought it into a fault."""
        with self.open_device() as device:
            before = self.position(device)
            yield device
            self.advance(self.stopping_time)
            assert self.is_near(device, before)
            assert device.fault == ""

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
            is_over = threading.Event()

            def command_on() -> None:
                while not is_over.is_set():
                    self.command(device, target, 1.0)

            commanding = pool.submit(command_on)
            try:
                self.advance(self.tick)
                self.stop(lambda: device.set_fault("watchdog"))
                with pytest.raises(DeviceFault, match="watchdog"):
                    commanding.result(timeout=self.time_limit)
            finally:  # also for a device that takes commands in fault, which nobody else would stop
                is_over.set()
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
        """A caller must not believe that the device holds."""
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
            here = self.position(device)  # motors with a goal of their own may have gone there meanwhile
            self.advance(self.stopping_time)
            assert self.is_at_rest(device)
            assert self.is_near(device, here)
            self.command(device, target)
            self.require_reached(device, target)
