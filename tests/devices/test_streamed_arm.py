"""Arms that a thread leads from command to command, with a vendor's functions in Python."""

from __future__ import annotations

import contextlib
import math
import subprocess
import sys
import threading
import time
from typing import Any

import numpy as np
import pytest

from rcs._core import MotionLimits, Trajectory
from rcs.devices import ArmLimits, ArmState, CommandKind, StreamedArm, StreamOptions, StreamPoint, TcpBox
from rcs.errors import DeviceFault, InvalidAction, InvalidSetup
from rcs.kinematics import kinematics_of
from rcs.robots import FR3, SO101
from rcs.testing import ArmContract

LIMITS = ArmLimits([-2.0, -1.5, -3.0], [2.0, 1.0, 0.5], [2.0, 1.5, 3.0], [10.0, 8.0, 12.0], [500.0, 1000.0, 5000.0])
START = np.array([0.1, -0.2, -0.5])
PERIOD, TICKS = 0.04, 10  # 250 Hz


class Servo(StreamedArm):
    """Joints that are where the points say."""

    def __init__(self, limits: ArmLimits = LIMITS, start: Any = START, **options: Any) -> None:
        options = {"rate": 250.0, "period": PERIOD, "missed_ticks": 1000, "silence": 5.0, **options}
        super().__init__("servo", limits, StreamOptions(**options))
        self.joints, self.velocities = np.array(start), np.zeros(len(start))
        self.points: list[StreamPoint] = []
        self.calls: list[str] = []
        self.error: Exception | None = None
        self.has_reflex = False
        self._go, self._idle = threading.Semaphore(0), threading.Semaphore(0)
        self.is_free = not options.get("is_paced_by_read", False)

    def advance(self, ticks: int) -> None:
        """Let so many ticks pass; the thread then waits for the next."""
        for _ in range(ticks):
            self._go.release()
            self._idle.acquire()

    def _open(self) -> None:
        self.calls.append("open")

    def _start(self) -> None:
        self.calls.append("start")

    def _read(self) -> ArmState:
        if not self.is_free and threading.current_thread() is not threading.main_thread() and self.calls[-1] != "start":
            self._idle.release()
            self._go.acquire()
        if self.calls[-1] == "start":
            self.calls.append("read")
        if self.error is not None:
            raise self.error
        return ArmState(self.joints, self.velocities)

    def _write(self, point: StreamPoint) -> None:
        if self.has_reflex:
            raise RuntimeError("reflex")
        self.points.append(point)
        self.joints, self.velocities = point.position, point.velocity

    def _stop(self) -> None:
        self.calls.append("stop")

    def _clear(self) -> None:
        self.calls.append("clear")
        self.has_reflex = False

    def _close(self) -> None:
        self.calls.append("close")

    def open_and_wait(self) -> Servo:
        """Open it, and return when its thread waits for the first tick."""
        self.open()
        self._idle.acquire()
        return self

    def run_freely(self) -> None:
        self.is_free = True
        self._go.release()


class TestStreamedArm(ArmContract):
    stopping_time = 0.4

    def make_arm(self) -> StreamedArm:
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


def await_fault(device: StreamedArm) -> None:
    for _ in range(3000):
        if device.fault:
            return
        time.sleep(0.001)
    pytest.fail("no fault came")


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


class Mover(Servo):
    """A servo that takes velocities, too, and comes to rest from them in ten ticks."""

    def __init__(self, **options: Any) -> None:
        super().__init__(is_paced_by_read=True, more_commands={CommandKind.velocities}, **options)
        self.braked = 0

    def _write_other(self, kind: CommandKind, values: Any) -> None:
        assert kind == CommandKind.velocities
        self.joints, self.velocities, self.braked = self.joints + values / 250.0, values, 0

    def _brake_other(self) -> bool:
        self.braked += 1
        self.velocities = self.velocities * 0.0 if self.braked >= 10 else self.velocities * 0.5
        self.joints = self.joints + self.velocities / 250.0
        return self.braked >= 10


def test_other_commands_go_to_the_arm_as_they_are_in_every_tick() -> None:
    with Mover().open_and_wait() as arm:
        assert arm.commands() == {CommandKind.joints, CommandKind.velocities}
        arm.command_velocities(np.array([0.5, 0.0, -0.5]))
        arm.advance(50)
        assert arm.joints - START == pytest.approx([0.1, 0.0, -0.1], abs=0.005)
        assert arm.points == []
        assert not arm.has_arrived()
        arm.run_freely()


def test_other_commands_end_with_a_hold_or_with_their_time_and_joints_lead_from_there() -> None:
    with Mover().open_and_wait() as arm:
        arm.command_velocities(np.array([0.5, 0.0, 0.0]))
        arm.advance(10)
        arm.hold()
        arm.advance(12)
        assert arm.has_arrived()
        at_rest = arm.joints.copy()
        arm.advance(5)
        assert (arm.joints == at_rest).all()
        arm.command_velocities(np.array([0.5, 0.0, 0.0]), valid_for=0.02)
        time.sleep(0.03)
        arm.advance(15)
        assert arm.has_arrived()
        arm.command_joints(arm.joints + 0.01)
        arm.advance(100)
        assert arm.joints == pytest.approx(at_rest + 0.01, abs=0.02)
        arm.run_freely()


def test_another_kind_of_command_is_refused_while_the_arm_moves() -> None:
    with Mover().open_and_wait() as arm:
        arm.command_velocities(np.array([0.5, 0.0, 0.0]))
        arm.advance(5)
        with pytest.raises(InvalidAction, match="another kind of command"):
            arm.command_joints(arm.joints)
        arm.command_velocities(np.array([0.2, 0.0, 0.0]))
        arm.hold()
        arm.advance(12)
        arm.command_joints(arm.joints + 0.1)
        arm.advance(5)
        with pytest.raises(InvalidAction, match="another kind of command"):
            arm.command_velocities(np.array([0.1, 0.0, 0.0]))
        arm.run_freely()


def test_other_commands_that_fail_are_a_fault() -> None:
    class Broken(Mover):
        def _write_other(self, kind: CommandKind, values: Any) -> None:
            raise DeviceFault("the motor of joint 2 is off")

    with Broken().open_and_wait() as arm:
        arm.command_velocities(np.array([0.5, 0.0, 0.0]))
        arm.run_freely()
        await_fault(arm)
        assert "joint 2 is off" in arm.fault
        assert "stop" in arm.calls


def test_a_command_that_comes_while_an_arm_breaks_down_is_not_refused_for_its_distance() -> None:
    class Slow(Servo):
        """Its controller takes its time to stop; only then is the fault known."""

        def _stop(self) -> None:
            super()._stop()
            time.sleep(0.3)

    with Slow() as arm:
        arm.command_joints(START)
        time.sleep(0.1)
        arm.has_reflex = True
        while "stop" not in arm.calls:
            time.sleep(1e-3)
        assert arm.fault == ""
        arm.command_joints(START + 0.3)
        time.sleep(0.4)
        assert "reflex" in arm.fault
        count = len(arm.points)
        arm.recover()
        time.sleep(0.1)
        assert len(arm.points) == count


def test_commands_go_on_while_the_first_one_starts_an_arm_that_takes_its_time() -> None:
    class Slow(Servo):
        def _start(self) -> None:
            super()._start()
            time.sleep(0.3)

    with Slow() as arm:
        arm.command_joints(START)
        while "start" not in arm.calls:
            time.sleep(1e-3)
        arm.command_joints(START + 0.3)
        time.sleep(0.25)
        assert not arm.points
        end = time.monotonic() + 3.0
        while not arm.has_arrived():
            assert time.monotonic() < end
            time.sleep(0.01)
        assert arm.joints == pytest.approx(START + 0.3, abs=1e-6)
        assert np.abs(np.diff([point.position for point in arm.points], axis=0)).max() <= 3.0 / 250 + 1e-9


@pytest.mark.parametrize(("rate", "period"), [(100.0, 1 / 90), (500.0, 1 / 90), (100.0, 1 / 30), (1000.0, 1 / 30)])
def test_commands_at_any_rate_do_not_lead_a_joint_out_of_its_range(rate: float, period: float) -> None:
    margin = 0.01
    limits = ArmLimits(SO101.joint_lower, SO101.joint_upper, [2.8] * 5, [15.0] * 5, [3000.0] * 5)
    lower, upper = np.array(SO101.joint_lower), np.array(SO101.joint_upper)

    class Hurried(StreamedArm):
        """Goes there and back at full speed, as far as the range goes, at the rate of commands."""

        def __init__(self) -> None:
            options = {"tracking_error": 10.0, "margin": margin, "is_paced_by_read": True}
            super().__init__("hurried", limits, StreamOptions(rate=rate, period=period, **options))
            self.target = self.joints = np.array(SO101.home)
            self.points: list[Any] = []
            self.count, self.passed, self.way = 0, 0.0, np.zeros(5)
            self.random = np.random.default_rng(0)

        def _read(self) -> ArmState:
            return ArmState(self.joints, np.zeros(5))

        def _stop(self) -> None:
            pass

        def _write(self, point: StreamPoint) -> None:
            self.joints = point.position
            self.points.append(point.position)
            self.passed += 1 / rate
            if self.passed < period or self.count > 600:
                return
            self.passed -= period
            if self.count % 20 == 0:
                self.way = 2.8 * period * np.where(self.random.random(5) < 0.5, -1.0, 1.0)
            self.count += 1
            self.target = np.clip(self.target + self.way * self.random.choice([1.0, 0.5]), lower, upper)
            self.command_joints(self.target)

    with Hurried() as arm:
        arm.command_joints(arm.joints)
        end = time.monotonic() + 30.0
        while arm.count <= 600:
            assert time.monotonic() < end
            time.sleep(0.01)
    points = np.array(arm.points)
    assert np.ptp(points, axis=0).max() > 2.0
    assert (points <= upper - margin + 1e-5).all()
    assert (points >= lower + margin - 1e-5).all()
