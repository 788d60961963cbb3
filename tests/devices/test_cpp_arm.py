"""An arm written in C++ outside of the project is as good as one from inside."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from rcs.devices import Arm, ArmLimits
from rcs.errors import DeviceFault
from rcs.testing import ArmContract


class TestRampArm(ArmContract):
    @pytest.fixture(autouse=True)
    def _from_the_extension(self, ramp_arm: ModuleType, limits: ArmLimits) -> None:
        self.module, self.limits = ramp_arm, limits

    def make_arm(self) -> Arm:
        self.arm = self.module.RampArm("ramp", self.limits)
        return self.arm

    def advance(self, seconds: float) -> None:
        self.arm.advance(seconds)


@pytest.fixture
def arm(ramp_arm: ModuleType, limits: ArmLimits):
    arm = ramp_arm.RampArm("ramp", limits)
    arm.open()
    yield arm
    arm.close()


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


def test_an_exception_of_the_device_reaches_python_with_its_message(arm) -> None:
    arm.disconnect()
    with pytest.raises(RuntimeError, match="no answer from the controller"):
        arm.command_joints(np.zeros(3))
