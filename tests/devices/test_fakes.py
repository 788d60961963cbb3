from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
import pytest

from rcs.devices import Arm, ArmLimits, Camera, CameraMode, Gripper
from rcs.devices.fakes import FakeArm, FakeCamera, FakeGripper, FakeHand
from rcs.errors import DeviceFault, InvalidAction, WrongOrder
from rcs.testing import ArmContract, CameraContract, GripperContract


class TestFakeArm(ArmContract):
    @pytest.fixture(autouse=True)
    def _on_a_hand_clock(self, clock: Callable[[], float], limits: ArmLimits) -> None:
        self.clock, self.limits = clock, limits

    def make_arm(self) -> Arm:
        return FakeArm(self.limits, clock=self.clock)

    def advance(self, seconds: float) -> None:
        self.clock.advance(seconds)


class TestFakeArmThatTrips(TestFakeArm):
    def provoke_fault(self, arm: Arm) -> None:
        arm.trip("collision")
        with pytest.raises(DeviceFault, match="hold is refused in a reflex"):
            arm.hold()


class TestFakeGripper(GripperContract):
    @pytest.fixture(autouse=True)
    def _on_a_hand_clock(self, clock: Callable[[], float]) -> None:
        self.clock = clock

    def make_gripper(self) -> Gripper:
        return FakeGripper(clock=self.clock)

    def advance(self, seconds: float) -> None:
        self.clock.advance(seconds)


class TestFakeCamera(CameraContract):
    @pytest.fixture(autouse=True)
    def _on_a_hand_clock(self, clock: Callable[[], float]) -> None:
        self.clock = clock

    def make_camera(self) -> Camera:
        return FakeCamera(CameraMode(16, 8, 30.0, True), clock=self.clock)

    def advance(self, seconds: float) -> None:
        self.clock.advance(seconds)


class TestFakeCameraWithoutDepth(TestFakeCamera):
    def make_camera(self) -> Camera:
        return FakeCamera(CameraMode(8, 16, 60.0), clock=self.clock)


def test_a_fake_arm_moves_at_its_largest_velocity(limits: ArmLimits, clock) -> None:
    arm = FakeArm(limits, clock=clock, start=np.zeros(3))
    arm.open()
    arm.command_joints(np.array([1.0, 1.0, 1.0]))
    clock.advance(0.25)
    np.testing.assert_allclose(arm.state().joints, [0.25, 0.5, 0.125], atol=1e-12)
    np.testing.assert_allclose(arm.state().joints, [0.25, 0.5, 0.125], atol=1e-12)


def test_a_fake_camera_repeats_its_frame_until_the_next_one_is_due(clock) -> None:
    camera = FakeCamera(CameraMode(16, 4, 30.0), clock=clock)
    camera.open()
    first = camera.read()
    clock.advance(0.2 / 30)
    assert camera.read().number == first.number
    clock.advance(1.0 / 30)
    second = camera.read()
    assert second.number == first.number + 1
    assert not np.array_equal(first.rgb, second.rgb)


def test_a_fake_hand_takes_normalised_joints_only(clock) -> None:
    hand = FakeHand(4, clock=clock)
    with pytest.raises(WrongOrder):
        hand.command_joints(np.zeros(4))
    hand.open()
    hand.command_joints(np.array([0.0, 0.25, 0.5, 1.0]))
    assert hand.has_arrived()
    for bad in (np.zeros(3), np.full(4, 1.01), np.full(4, np.nan)):
        with pytest.raises(InvalidAction):
            hand.command_joints(bad)
    np.testing.assert_array_equal(hand.state().joints, [0.0, 0.25, 0.5, 1.0])
    hand.hold()
    hand.recover()
    hand.close()
    hand.close()


def test_the_fault_is_read_and_set_while_a_measurement_takes_its_time(limits: ArmLimits, clock) -> None:
    entered, let_go = threading.Event(), threading.Event()

    def slow_clock() -> float:
        if threading.current_thread() is not threading.main_thread():
            entered.set()
            assert let_go.wait(2.0)
        return clock()

    arm = FakeArm(limits, clock=slow_clock)
    arm.open()
    thread = threading.Thread(target=arm.state)
    thread.start()
    assert entered.wait(2.0)
    assert arm.is_open
    assert arm.fault == ""
    arm.set_fault("watchdog")
    assert arm.fault == "watchdog"
    assert thread.is_alive()
    let_go.set()
    thread.join()
