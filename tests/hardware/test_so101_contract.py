"""The contract of every arm and gripper, of an SO101 over the vendor's library against the virtual one."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator

import pytest

from rcs.devices import Arm, Gripper
from rcs.errors import DeviceFault
from rcs.hardware import DeviceAddress
from rcs.hardware.so101 import So101Arm, So101Driver, So101Gripper
from rcs.hardware.so101_servos import ARM, GRIPPER, TORQUE_ON
from rcs.robots.so101 import SO101, SO101_GRIPPER
from rcs.testing import ArmContract, GripperContract
from rcs.virtual import VirtualProcess

pytestmark = [pytest.mark.hardware, pytest.mark.slow]
pytest.importorskip("scservo_sdk", reason="the driver of SO101 arms needs feetech-servo-sdk")


class OnVirtualArm:
    """Both devices of a virtual arm of their own per test."""

    virtual: VirtualProcess
    max_age = 1.0

    @pytest.fixture(autouse=True)
    def run_virtual(self) -> Iterator[None]:
        with VirtualProcess("so101") as virtual:
            type(self).virtual = virtual
            yield

    def entry(self) -> tuple[So101Driver, str, dict]:
        entry = self.virtual.site.arms["so101"]
        assert isinstance(entry, DeviceAddress)
        return So101Driver(), entry.address, {**entry.options, "timeout": 0.3}

    def lose_link(self, device: Arm | Gripper) -> None:
        self.tell(device, "cut")
        time.sleep(0.6 if device.is_open else 0.0)  # the request that is under way ends

    def tell(self, device: Arm | Gripper, *fault: str) -> None:
        """Have something go wrong, and read until an open device knows."""
        self.virtual.tell(*fault)
        if not device.is_open:
            return
        end = time.monotonic() + 5.0
        while device.fault == "" and time.monotonic() < end:
            with contextlib.suppress(DeviceFault):
                device.state()

    def restore_link(self, device: Arm | Gripper) -> None:
        self.virtual.tell("clear")

    def is_energised(self, device: Arm | Gripper) -> bool | None:
        assert isinstance(device, So101Arm | So101Gripper)
        servos = ARM if isinstance(device, So101Arm) else [GRIPPER]
        end = time.monotonic() + 0.5  # a first command switches on in its own time
        is_on = False
        while not is_on and time.monotonic() < end:
            with device.link as link:
                is_on = any(values[0] for _, values in link.bus.read(list(servos), TORQUE_ON[0], 1).values())
        return is_on


class TestSo101Arm(OnVirtualArm, ArmContract):
    tolerance = 6e-3  # a position of the encoder is 1.5e-3 rad
    still = 0.03
    at_close = "hold"

    def make_device(self) -> Arm:
        driver, address, options = self.entry()
        # It has no brakes: one that is released when it is closed falls, and is not at rest for a while.
        return driver.arm(address, SO101, {**options, "at_close": self.at_close})

    def test_opening_energises_and_moves_nothing(self) -> None:
        """Closing takes the power away where it is to be released, and not where it is to hold."""
        self.at_close = "release"
        super().test_opening_energises_and_moves_nothing()

    def provoke_fault(self, device: Arm) -> None:
        self.tell(device, "overload", "wrist_roll")


class TestSo101Gripper(OnVirtualArm, GripperContract):
    tolerance = 0.03

    def make_device(self) -> Gripper:
        driver, address, options = self.entry()
        return driver.gripper(address, SO101_GRIPPER, options)

    def provoke_fault(self, device: Gripper) -> None:
        self.tell(device, "overload", "gripper")
