"""An arm written in C++ outside of the project, against the wheel alone, is as good as one from inside."""

from __future__ import annotations

import ctypes
import os
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from rcs.devices import Arm, ArmLimits, CommandKind, StreamOptions
from rcs.errors import DeviceFault
from rcs.testing import ArmContract

pytestmark = pytest.mark.slow  # what it tests is compiled


class TestRampArm(ArmContract):
    @pytest.fixture(autouse=True)
    def _from_the_extension(self, ramp_arm: ModuleType, limits: ArmLimits) -> None:
        self.module, self.limits = ramp_arm, limits

    def make_device(self) -> Arm:
        self.arm = self.module.RampArm("ramp", self.limits)
        return self.arm

    def advance(self, seconds: float) -> None:
        self.arm.advance(seconds)

    def lose_link(self, device: Any) -> None:
        device.disconnect()

    def restore_link(self, device: Any) -> None:
        device.reconnect()


class TestThreadedArm(ArmContract):
    distance = 0.3
    stopping_time = 0.05

    @pytest.fixture(autouse=True)
    def _from_the_extension(self, import_device: Callable[[str], ModuleType], limits: ArmLimits) -> None:
        self.module, self.limits = import_device("threaded_arm"), limits

    def make_device(self) -> Arm:
        return self.module.ThreadedArm(self.limits)

    def lose_link(self, device: Any) -> None:
        device.lose_link()

    def restore_link(self, device: Any) -> None:
        device.restore_link()

    def test_velocities_end_when_their_time_is_over(self) -> None:
        with self.open_device() as arm:
            assert arm.commands() == {CommandKind.joints, CommandKind.velocities}
            before = self.position(arm)
            arm.command_velocities(np.full(3, 0.1), valid_for=0.05)
            self.move(arm)
            assert (self.position(arm) > before).all()
            assert (self.position(arm) < arm.limits.joint_upper).all()


@pytest.fixture
def servo_arm(import_device: Callable[[str], ModuleType], limits: ArmLimits) -> Callable[[], Any]:
    """Make a streamed arm that stands a busy machine."""
    module = import_device("servo_arm")
    rates = limits.joint_velocity, np.full(3, 5.0), np.full(3, 500.0)
    limits = ArmLimits(limits.joint_lower, limits.joint_upper, *rates)
    return lambda: module.ServoArm(limits, StreamOptions(missed_ticks=2000, silence=5.0))


class TestServoArm(ArmContract):
    stopping_time = 0.5

    @pytest.fixture(autouse=True)
    def _from_the_extension(self, servo_arm: Callable[[], Any]) -> None:
        self.make = servo_arm

    def make_device(self) -> Arm:
        return self.make()

    def lose_link(self, device: Any) -> None:
        device.lose_link()
        while not device.fault:
            time.sleep(0.001)

    def restore_link(self, device: Any) -> None:
        device.restore_link()


def test_an_interpreter_that_is_kept_busy_does_not_delay_the_end_of_a_command(servo_arm: Callable[[], Any]) -> None:
    keep_the_lock = ctypes.PyDLL(None).usleep  # as many libraries in C do
    delays = []
    for _ in range(5):
        with servo_arm() as arm:
            here = arm.state().joints
            arm.command_joints(here)
            while arm.ticks < 3:
                time.sleep(0.001)
            begin = time.monotonic()
            arm.command_joints(here + [0.9, 0.0, 0.0], valid_for=0.05)
            keep_the_lock(600_000)
            times, accelerations = np.array([entry for entry in arm.log() if entry[0] > begin]).T
            delays.append(times[(times > begin + 0.03) & (accelerations < 4.9)][0] - begin)
            assert accelerations[times > begin + 0.5] == pytest.approx(0.0)
            assert arm.lapses == 1
            assert arm.fault == ""
    assert min(delays) >= 0.05
    assert min(delays) <= 0.06


@pytest.fixture
def arm(ramp_arm: ModuleType, limits: ArmLimits):
    arm = ramp_arm.RampArm("ramp", limits)
    arm.open()
    yield arm
    arm.close()


def test_the_wheel_alone_serves_an_arm_in_cpp(wheel_python: Path, cpp_devices: Path) -> None:
    program = """
import rcs.devices, ramp_arm
limits = rcs.devices.ArmLimits([-1.0], [1.0], [1.0])
with ramp_arm.RampArm("ramp", limits) as arm:
    rcs.devices.stop_all("from the library that both share")
    print(rcs.__file__)
    print(arm.fault)
"""
    environment = {**os.environ, "PYTHONPATH": str(cpp_devices)}
    done = subprocess.run([wheel_python, "-c", program], capture_output=True, text=True, env=environment, check=False)
    file, fault = done.stdout.splitlines() or [done.stderr, ""]
    assert Path(file).is_relative_to(wheel_python.parents[1])
    assert fault == "from the library that both share"


def test_a_module_of_another_version_of_the_interfaces_is_not_imported(
    import_device: Callable[[str], ModuleType],
) -> None:
    with pytest.raises(ImportError, match=r"compiled for version 1 of the device interfaces.*compile the device anew"):
        import_device("old_arm")


def test_an_extension_shares_the_types_of_the_core(arm) -> None:
    assert isinstance(arm, Arm)
    assert isinstance(arm.limits, ArmLimits)


def test_a_measurement_with_a_joint_too_few_is_a_fault(arm) -> None:
    arm.lose_joint()
    with pytest.raises(DeviceFault, match=r"measured 2 joints, it has 3"):
        arm.state()
    assert "2 joints" in arm.fault


def test_a_measurement_that_is_not_finite_is_a_fault_that_stays(arm) -> None:
    arm.measure_nan()
    with pytest.raises(DeviceFault, match="not finite at joint 0"):
        arm.state()
    with pytest.raises(DeviceFault, match="recover"):
        arm.command_joints(np.zeros(3))


def test_an_exception_of_the_device_is_a_fault_with_its_message(arm) -> None:
    arm.disconnect()
    with pytest.raises(DeviceFault, match="ramp: command_joints failed: no answer from the controller"):
        arm.command_joints(np.zeros(3))
