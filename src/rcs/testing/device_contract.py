"""The contract of every device, as tests: its life from `open` to `close`, faults, the link, and guiding by hand."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

import pytest

from rcs.devices import Device
from rcs.errors import DeviceFault, InvalidAction, WrongOrder

D = TypeVar("D", bound=Device)


class DeviceContract(Generic[D]):
    """Checks the clauses that arms, grippers, hands and cameras share. Subclass the contract of your kind instead."""

    max_age: float = 0.5
    """Largest age of a measurement when it is returned [s]."""

    def make_device(self) -> D:
        """Return a new device, not opened. To be overridden."""
        raise NotImplementedError("override make_device and return a new device that is not opened")

    def measure(self, device: Any) -> Any:
        """Return what the device measures now, with its times: its state, if it has one."""
        return device.state()

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
        """Return whether an open device's motors have power, None if unknown; override it where a test can find out."""
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
        """The moment of the measurement, also after a pause; the device's own clock does not run backwards."""
        with self.open_device() as device:
            begin = time.monotonic()
            first = self.measure(device)
            self.advance(1.5 * self.max_age)
            asked = time.monotonic()
            second = self.measure(device)
            assert begin - self.max_age <= first.time <= second.time <= time.monotonic()
            assert second.time >= asked - self.max_age
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


def in_a_thread(call: Callable[[], None]) -> None:
    """Make a call from another thread, and raise here what it raises."""
    with ThreadPoolExecutor(1) as pool:
        pool.submit(call).result()
