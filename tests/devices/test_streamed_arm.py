"""Arms that a thread leads from command to command, with a vendor's functions in Python."""

from __future__ import annotations

import contextlib
import math
import subprocess
import sys
import time
from typing import Any

import numpy as np
import pytest

from rcs._core import MotionLimits, Trajectory
from rcs.devices import ArmLimits, ArmState, StreamedArm, TcpBox
from rcs.errors import DeviceFault, InvalidAction, InvalidSetup
from rcs.kinematics import kinematics_of
from rcs.robots import FR3
from rcs.testing import ArmContract
from tests.devices.servo import LIMITS, PERIOD, START, TICKS, Servo, await_fault


class TestStreamedArm(ArmContract):
    stopping_time = 0.4

    def make_device(self) -> StreamedArm:
        return Servo()

    def lose_link(self, device: Any) -> None:
        device.error = OSError("no answer from the controller")
        await_fault(device)

    def restore_link(self, device: Any) -> None:
        device.error = None

    def provoke_fault(self, device: Any) -> None:
        device.has_reflex = True
        with contextlib.suppress(DeviceFault):  # it may have come already
            device.command_joints(device.state().joints)
        await_fault(device)


def test_the_points_are_those_of_the_law_of_simulated_arms() -> None:
    law = Trajectory(
        MotionLimits(
            LIMITS.joint_lower, LIMITS.joint_upper, LIMITS.joint_velocity, LIMITS.joint_acceleration, LIMITS.joint_jerk
        )
    )
    memory = np.zeros(Trajectory.size(3))
    for row in Trajectory.POSITION_ROWS:
        memory[3 * row : 3 * row + 3] = START
    arm = Servo(is_paced_by_read=True, tracking_error=10.0).open_and_wait()
    random, target, expected = np.random.default_rng(5), np.array(START), []
    for _ in range(60):
        target = np.clip(target + random.normal(0.0, 0.05, 3), LIMITS.joint_lower, LIMITS.joint_upper)
        arm.command_joints(target)
        arm.advance(TICKS)
        memory[:3] = target
        law.follow(memory, PERIOD)
        for _ in range(TICKS):
            law.advance(memory, 1 / 250.0)
            expected.append(law.state(memory))
    arm.run_freely()
    arm.close()
    written = np.array([[p.position, p.velocity, p.acceleration] for p in arm.points[: len(expected)]])
    np.testing.assert_array_equal(written, expected)


def test_the_vendors_functions_are_called_in_order() -> None:
    arm = Servo()
    arm.open()
    assert arm.calls == ["open"]
    with pytest.raises(InvalidAction, match=r"joint 2 is at -0.5 rad .* 1 rad away, valid is at most 0.2 rad"):
        arm.command_joints(START + [0, 0, 1])
    assert arm.ticks == 0
    arm.command_joints(START)
    while arm.ticks < 3:
        time.sleep(0.001)
    arm.has_reflex = True
    await_fault(arm)
    assert arm.fault == "write failed: RuntimeError: reflex"
    with pytest.raises(DeviceFault, match="reflex"):
        arm.command_joints(START)
    arm.recover()
    arm.close()
    assert arm.calls == ["open", "start", "read", "stop", "clear", "close"]
    assert math.isclose(sum(arm.clamped().values()), 0)


def test_a_fault_of_a_read_stays_until_it_reads_again() -> None:
    with Servo() as arm:
        arm.error = OSError("no answer from the controller")
        await_fault(arm)
        assert arm.fault == "read failed: OSError: no answer from the controller"
        with pytest.raises(DeviceFault, match="no answer from the controller"):
            arm.state()
        with pytest.raises(DeviceFault, match="recover failed: OSError: no answer"):
            arm.recover()
        arm.error = None
        arm.recover()
        np.testing.assert_array_equal(arm.state().joints, START)


class Hesitant(OSError):
    """An exception that takes its time to say what it is."""

    def __str__(self) -> str:
        time.sleep(0.1)
        return "no answer"


class Mute(OSError):
    """An exception that fails to say what it is."""

    def __str__(self) -> str:
        raise ValueError("no words")


@pytest.mark.parametrize(("error", "text"), [(Hesitant(), "no answer"), (Mute(), "(its text cannot be shown)")])
def test_a_fault_of_a_read_has_the_drivers_words_also_when_they_come_late(error: Exception, text: str) -> None:
    with Servo() as arm:
        arm.error = error
        with contextlib.suppress(DeviceFault):
            while not arm.fault:
                arm.state()
        assert arm.fault.startswith("read failed: ")
        assert f"{type(error).__name__}: {text}" in arm.fault


def test_the_tcp_stays_in_its_box() -> None:
    kinematics = kinematics_of(FR3)
    home = np.array(FR3.home)
    z = kinematics.forward(home).translation[2]
    limits = ArmLimits(
        FR3.joint_lower, FR3.joint_upper, FR3.velocity_limit, FR3.acceleration_limit, FR3.jerk_limit, FR3.effort_limit
    )
    box = TcpBox([-2.0, -2.0, z - 0.1], [2.0, 2.0, 2.0], kinematics)
    arm = Servo(limits, home, is_paced_by_read=True, box=box).open_and_wait()
    arm.command_joints(home)
    arm.advance(TICKS)
    arm.command_joints(home + [0, 0.6, 0, 0, 0, 0, 0])  # leans forward, and down
    arm.advance(20 * TICKS)
    arm.run_freely()
    arm.close()
    lowest = min(kinematics.forward(p.position).translation[2] for p in arm.points)
    assert z - 0.1 - 1e-3 <= lowest < z - 0.09
    assert arm.clamped()["box"] == 1


def test_options_and_limits_that_make_no_sense_are_refused() -> None:
    with pytest.raises(InvalidSetup, match="10 to 2000 Hz"):
        Servo(rate=1.0)
    with pytest.raises(InvalidSetup, match="a streamed arm needs limits of acceleration and jerk"):
        Servo(ArmLimits([-1.0], [1.0], [1.0]))
    arm = Servo()
    with pytest.raises(InvalidSetup, match="period"):
        arm.period = -1.0
    arm.period = 0.02
    assert arm.period == 0.02


def test_an_arm_without_its_functions_says_which_is_missing() -> None:
    class Bare(StreamedArm):
        def _read(self) -> ArmState:
            return ArmState(START, np.zeros(3))

        def _stop(self) -> None:
            pass

    with Bare("bare", LIMITS) as arm:
        arm.command_joints(START)
        await_fault(arm)
        assert "Bare must define the method _write" in arm.fault


def test_a_program_that_ends_lets_its_arm_brake_first() -> None:
    program = """
import atexit, time
from tests.devices.test_streamed_arm import START, Servo
arm = Servo(rate=1000.0)
def tell():
    last = arm.points[-1]
    print(abs(last.velocity).max() < 1e-9, 0.0 < last.position[0] - START[0] < 1.4)
atexit.register(tell)  # what is registered first is called last
arm.open()
arm.command_joints(START)
while not arm.ticks:
    time.sleep(0.001)
arm.command_joints(START + [1.5, 0.0, 0.0])
time.sleep(0.15)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "True True\n", "")
