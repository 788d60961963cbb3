from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from rcs.devices import Arm, ArmLimits, ArmState, Camera, CameraCalibration, CameraMode, Gripper, Hand
from rcs.devices.fakes import FakeArm, FakeCamera, FakeGripper, FakeHand
from rcs.errors import DeviceFault, InvalidAction
from rcs.robots.tactile import DIGIT
from rcs.testing import ArmContract, CameraContract, GripperContract, HandContract, TactileContract

CALIBRATION = CameraCalibration(np.array([[10.0, 0.0, 7.5], [0.0, 10.0, 3.5], [0.0, 0.0, 1.0]]), [0.1, -0.02])


class OnAHandClock:
    """The parts that the contracts of all fakes share."""

    @pytest.fixture(autouse=True)
    def _on_a_hand_clock(self, clock: Callable[[], float], limits: ArmLimits) -> None:
        self.clock, self.limits = clock, limits

    def advance(self, seconds: float) -> None:
        self.clock.advance(seconds)

    def lose_link(self, device: Any) -> None:
        device.lose_link()

    def restore_link(self, device: Any) -> None:
        device.restore()

    def is_energised(self, device: Any) -> bool:
        return device.body.has_power


class TestFakeArm(OnAHandClock, ArmContract):
    def make_device(self) -> Arm:
        return FakeArm(self.limits, clock=self.clock)


class TestFakeGripper(OnAHandClock, GripperContract):
    def make_device(self) -> Gripper:
        return FakeGripper(clock=self.clock)


class TestFakeHand(OnAHandClock, HandContract):
    def make_device(self) -> Hand:
        return FakeHand(3, clock=self.clock)


class TestFakeCamera(OnAHandClock, CameraContract):
    def make_device(self) -> Camera:
        return FakeCamera(CameraMode(16, 8, 30.0, True), calibration=CALIBRATION, clock=self.clock)


class TestFakeCameraWithoutDepth(TestFakeCamera):
    def make_device(self) -> Camera:
        return FakeCamera(CameraMode(8, 16, 60.0), clock=self.clock)


class TestFakeTactile(OnAHandClock, TactileContract):
    def make_device(self) -> Camera:
        return FakeCamera(CameraMode(*DIGIT.frame_size, 60.0), clock=self.clock)


class Trips(OnAHandClock):
    def provoke_fault(self, device: Any) -> None:
        device.trip("collision")
        with pytest.raises(DeviceFault, match="hold is refused in a reflex"):
            device.hold()


class TestFakeArmThatTrips(Trips, TestFakeArm):
    pass


class TestFakeGripperThatTrips(Trips, TestFakeGripper):
    pass


class TestFakeHandThatTrips(Trips, TestFakeHand):
    pass


def test_a_device_that_takes_commands_in_fault_fails_and_is_commanded_no_more(limits: ArmLimits, clock) -> None:
    commands: list[float] = []

    class Deaf(TestFakeArm):
        time_limit = 0.05

        def command(self, device: Arm, target: Any, valid_for: float = np.inf) -> None:
            commands.append(valid_for)
            with suppress(DeviceFault):
                super().command(device, target, valid_for)

    contract = Deaf()
    contract.clock, contract.limits = clock, limits
    with pytest.raises(TimeoutError):
        contract.test_a_thread_that_commands_meets_the_fault()
    sent = len(commands)
    threading.Event().wait(0.01)
    assert len(commands) == sent > 1


def test_a_device_whose_measurements_keep_their_time_fails(limits: ArmLimits) -> None:
    class Frozen(FakeArm):
        began = 0.0

        def _open(self) -> None:
            super()._open()
            self.began = time.monotonic()

        def _state(self) -> ArmState:
            now = super()._state()
            return ArmState(list(now.joints), list(now.joint_velocities), time=self.began)

    class Contract(ArmContract):
        max_age = 0.1

        def make_device(self) -> Arm:
            return Frozen(limits)

    with pytest.raises(AssertionError):
        Contract().test_a_measurement_has_the_time_of_the_host()


def test_a_camera_without_a_serial_number_that_is_another_one_afterwards_fails(clock) -> None:
    class Exchanged(FakeCamera):
        opened = 0

        def _open(self) -> None:
            super()._open()
            self.opened += 1

        @property
        def about(self) -> dict[str, Any]:
            return {"model": f"camera {self.opened}"}

    class Contract(TestFakeCamera):
        def make_device(self) -> Camera:
            return Exchanged(CameraMode(16, 8, 30.0), clock=clock)

    with pytest.raises(AssertionError):
        Contract().test_it_is_the_same_camera_when_it_is_opened_again()


def test_a_fake_arm_moves_at_its_largest_velocity(limits: ArmLimits, clock) -> None:
    arm = FakeArm(limits, clock=clock, start=np.zeros(3))
    arm.open()
    arm.command_joints(np.array([1.0, 1.0, 1.0]))
    clock.advance(0.25)
    np.testing.assert_allclose(arm.state().joints, [0.25, 0.5, 0.125], atol=1e-12)
    np.testing.assert_allclose(arm.state().joints, [0.25, 0.5, 0.125], atol=1e-12)


def test_a_joint_that_was_found_outside_its_limits_may_stay_and_come_back_and_go_no_farther(
    limits: ArmLimits, clock
) -> None:
    arm = FakeArm(limits, clock=clock, start=np.array([-1.5, 0.0, 0.0]))
    arm.open()
    with pytest.raises(InvalidAction, match=r"joints\[0\] is -1.5, valid is -1 to 1"):
        arm.command_joints(np.array([-1.5, 0.0, 0.0]))  # nobody has looked yet
    arm.state()
    for joint in (-1.5, -1.4, -1.4):
        arm.command_joints(np.array([joint, 0.0, 0.0]))
        clock.advance(0.2)
        assert arm.state().joints[0] == pytest.approx(joint)
    for joints in ([-1.5, 0.0, 0.0], [-1.4, 2.1, 0.0], [1.4, 0.0, 0.0]):
        with pytest.raises(InvalidAction, match="valid is"):
            arm.command_joints(np.array(joints))
    arm.command_joints(np.array([-0.9, 0.0, 0.0]))
    clock.advance(1.0)
    arm.state()
    arm.command_joints(np.array([-0.8, 0.0, 0.0]))
    with pytest.raises(InvalidAction, match="valid is -1 to 1"):
        arm.command_joints(np.array([-1.1, 0.0, 0.0]))
    arm.close()


def test_a_joint_outside_may_be_sent_where_it_was_measured_before_its_encoder_made_a_step(
    limits: ArmLimits, clock
) -> None:
    arm = FakeArm(limits, clock=clock, start=np.array([1.3, 0.0, 0.0]))
    arm.open()
    measured = arm.state().joints
    for joint in (1.2985, 1.3015):  # as a host measures while its program computes
        arm.body.values[0] = joint
        arm.state()
    arm.command_joints(measured)
    arm.body.values[0] = 1.2985
    arm.state()
    with pytest.raises(InvalidAction, match=r"valid is -1 to 1\.3"):
        arm.command_joints(np.array([1.3015, 0.0, 0.0]))
    arm.close()


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


def test_a_frozen_camera_repeats_its_frame_until_it_is_restored(clock) -> None:
    with FakeCamera(CameraMode(16, 4, 30.0), clock=clock) as camera:
        first = camera.read()
        camera.freeze()
        clock.advance(1.0)
        assert (camera.read().number, camera.read().time) == (first.number, first.time)
        camera.restore()
        assert camera.read().number == first.number + 30


def test_a_guided_fake_arm_stays_where_it_was_pushed(limits: ArmLimits, clock) -> None:
    with FakeArm(limits, clock=clock, start=np.zeros(3)) as arm:
        arm.command_joints(np.array([1.0, 1.0, 1.0]))
        clock.advance(0.1)
        arm.guide(True)
        assert arm.state().mode == "guided"
        clock.advance(1.0)
        arm.push(np.array([0.2, 0.0, 0.0]))
        arm.guide(False)
        clock.advance(1.0)
        state = arm.state()
        np.testing.assert_allclose(state.joints, [0.3, 0.2, 0.05])
        np.testing.assert_array_equal(state.commanded_joints, state.joints)
        np.testing.assert_array_equal(state.efforts, np.zeros(3))


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
