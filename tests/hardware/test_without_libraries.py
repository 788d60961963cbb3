"""Parts of drivers that need no library of a vendor, nor a robot."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rcs import Compliance
from rcs.devices import Device
from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware import franka, franka_pylibfranka, hosted, robotiq, ur, xarm
from rcs.hardware.driver import Driver
from rcs.hardware.franka import FrankaArm, FrankaDriver, FrankaOptions
from rcs.hardware.franka_faults import make_idle
from rcs.hardware.franka_pylibfranka import PylibfrankaArm
from rcs.hardware.link import Link
from rcs.hardware.robotiq import RobotiqDriver, RobotiqGripper
from rcs.hardware.robotiq_lines import RobotiqStatus
from rcs.hardware.servo_bus import ServoBus
from rcs.hardware.so101 import So101Arm, So101Options
from rcs.hardware.so101_servos import MotorCalibration, Reading
from rcs.hardware.tilburg import TilburgDriver
from rcs.hardware.ur import UrArm, UrDriver
from rcs.hardware.xarm import AT_REST, XarmArm, XarmDriver
from rcs.robots import FR3, FRANKA_HAND, ROBOTIQ_2F85, SO101, TILBURG_HAND, UR5E, XARM7
from rcs.robots.description import ArmDescription

NOTICING = 0.1
"""Time that `faults` of `benchmarks/hardware.py` leaves for noticing what is past a limit [s]."""


@pytest.mark.parametrize("driver", [franka, ur, xarm])
def test_an_arm_that_freezes_is_at_fault_within_three_tenths_of_a_second(driver: Any) -> None:
    assert driver.SILENCE + NOTICING <= 0.3 + 1e-9


@pytest.mark.parametrize(
    ("option", "least", "most"), [("speed", 0.01, 1.0), ("rate", 30.0, 250.0), ("tcp_speed", 0.001, 0.95)]
)
def test_an_option_of_an_xarm_outside_of_its_range_is_refused(option: str, least: float, most: float) -> None:
    for value in (least, most):
        XarmDriver().arm("192.0.2.1", XARM7, {option: value})
    for value in (0.99 * least, 1.01 * most):
        with pytest.raises(InvalidSetup, match=rf"{option} is .* from {least:g} to {most:g}"):
            XarmDriver().arm("192.0.2.1", XARM7, {option: value})


@pytest.mark.parametrize(("driver", "about"), [(XarmDriver(), XARM7), (UrDriver(), UR5E)])
@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tcp": [0, 0, 1]}, "a sequence of 7"),
        ({"tcp": [0.0] * 7}, "quaternion"),
        ({"rat": 100}, "Did you mean 'rate'"),
        ({"speed": "fast"}, "speed is 'fast'"),
    ],
)
def test_an_option_that_is_none_is_refused(
    driver: Driver, about: ArmDescription, options: dict[str, Any], words: str
) -> None:
    with pytest.raises(InvalidSetup, match=words):
        driver.arm("192.0.2.1", about, options)


@pytest.mark.parametrize(
    ("driver", "about", "words"),
    [
        (FrankaDriver(), UR5E, "controls the Franka Research 3; 'ur5e' has 6 joints, not 7. Choose the robot 'fr3'"),
        (FrankaDriver(), XARM7, r"'xarm7' has joint1 from -6.28 to 6.28 rad, not -2.74 to 2.74"),
        (XarmDriver(), FR3, r"controls the UFACTORY xArm 7; 'fr3' has joint4 from -3.04 to -0.15 rad, not -0.19"),
        (UrDriver(), FR3, r"six joints; 'fr3' has 7"),
    ],
)
def test_the_description_of_another_arm_is_refused(driver: Driver, about: ArmDescription, words: str) -> None:
    with pytest.raises(InvalidSetup, match=words):
        driver.arm("192.0.2.1", about, {})


def test_an_arm_whose_ranges_were_narrowed_is_taken() -> None:
    narrow = replace(FR3, joint_lower=tuple(0.9 * one for one in FR3.joint_lower[:3]) + FR3.joint_lower[3:])
    assert FrankaDriver().arm("192.0.2.1", narrow, {}).dof == 7


@pytest.mark.parametrize(
    "make",
    [
        lambda: FrankaDriver().arm("", FR3, {}),
        lambda: FrankaDriver().gripper("", FRANKA_HAND, {}),
        lambda: UrDriver().arm("", UR5E, {}),
        lambda: XarmDriver().arm("", XARM7, {}),
        lambda: RobotiqDriver().gripper("", ROBOTIQ_2F85, {}),
    ],
)
def test_a_device_without_an_address_is_refused(make: Callable[[], object]) -> None:
    with pytest.raises(InvalidSetup, match="has no address; give its IP address"):
        make()


class StuckGripper:
    """A Robotiq gripper that answers, but whose activation never begins; or raises what no driver expects."""

    def __init__(self) -> None:
        self.error: Exception | None = None

    def read(self) -> RobotiqStatus:
        if self.error is not None:
            raise self.error
        return RobotiqStatus(activation=0, goes=0, object=3, fault=0, request=0, position=3, time=time.monotonic())

    def write(self, **registers: Any) -> None:
        pass

    def close(self) -> None:
        pass


def wait_for_fault(device: Device) -> str:
    end = time.monotonic() + 10.0
    while not device.fault:
        assert time.monotonic() < end
        time.sleep(0.01)
    return device.fault


def test_a_gripper_whose_activation_does_not_begin_is_at_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robotiq, "ACTIVATION_TIME", 1.5)
    with RobotiqGripper("192.0.2.1", ROBOTIQ_2F85, {}, lambda _: StuckGripper()) as gripper:
        gripper.command_opening(0.0)
        assert "its activation has not ended after 1.5 s" in wait_for_fault(gripper)
        gripper.recover()
        assert not gripper.fault


def test_whatever_a_gripper_raises_is_its_fault_and_its_thread_goes_on() -> None:
    stuck = StuckGripper()
    with RobotiqGripper("192.0.2.1", ROBOTIQ_2F85, {}, lambda _: stuck) as gripper:
        stuck.error = AttributeError("no socket")
        assert "AttributeError: no socket" in wait_for_fault(gripper)
        stuck.error = None
        gripper.recover()
        time.sleep(1.0)
        gripper.state()  # is not older than 0.8 s
        assert not gripper.fault


class ShyRobot:
    """A Franka arm that is found in a reflex again after its first recoveries."""

    def __init__(self, reflexes: int) -> None:
        self.reflexes, self.recoveries, self.is_idle = reflexes, 0, False

    def recover(self) -> None:
        self.recoveries += 1
        self.is_idle = True
        self.seen = 0

    def state(self) -> SimpleNamespace:
        if self.is_idle and self.recoveries <= self.reflexes:
            self.seen += 1
            self.is_idle = self.seen < 5
        errors = SimpleNamespace(communication_constraints_violation=True)
        mode = "RobotMode.Idle" if self.is_idle else "RobotMode.Reflex"
        return SimpleNamespace(
            robot_mode=mode, current_errors=errors, last_motion_errors=errors, joint_collision=[False] * 7
        )


@pytest.mark.parametrize("reflexes", [0, 1, 2])
def test_a_late_reflex_is_recovered_too(reflexes: int) -> None:
    robot = ShyRobot(reflexes)
    make_idle(robot.state, robot.recover, FR3.joints)
    assert robot.recoveries == reflexes + 1


def test_an_arm_that_does_not_stay_idle_is_told_with_its_reflex() -> None:
    robot = ShyRobot(9)
    with pytest.raises(DeviceFault, match=r"mode Reflex.*communication_constraints_violation.*cable"):
        make_idle(robot.state, robot.recover, FR3.joints)
    assert robot.recoveries == 3


class LooseServos:
    """The servos of an SO101, of which one does not answer when it is switched on."""

    calibration = dict.fromkeys(range(1, 7), MotorCalibration(
        id=1, drive_mode=0, homing_offset=0, range_min=0, range_max=4000
    ))  # fmt: skip

    def __init__(self) -> None:
        self.on: set[int] = set()

    def check(self, *_: Any) -> None:
        pass

    def read(self) -> Reading:
        still, at = dict.fromkeys(range(1, 7), 0), dict.fromkeys(range(1, 7), 2000)
        return Reading(
            time=time.monotonic(), positions=at, speeds=still, errors=still, volts=dict.fromkeys(still, 12.0)
        )

    def newest(self, _: float) -> Reading:
        return self.read()

    def end_overload(self, _: Any) -> list[int]:
        return []

    hold = tune = lambda self, *_: None

    def power(self, servos: Any) -> None:
        for servo in servos:
            if servo in (3, 6):
                raise DeviceFault(f"no answer from servo {servo}")
            self.on.add(servo)

    def release(self, servos: Any) -> None:
        self.on -= {*servos}


def test_servos_that_are_on_when_one_does_not_answer_are_released_at_the_end() -> None:
    servos = LooseServos()
    link: Any = Link(lambda: servos, lambda _: None)
    arm = So101Arm(link, SO101.arm_limits, options=So101Options(), name="arm")
    with arm:
        arm.command_joints(arm.state().joints)
        wait_for_fault(arm)
        assert "no answer from servo 3" in arm.fault
        assert servos.on == {1, 2}
    assert servos.on == set()


def test_a_compliant_arm_may_be_pushed_away_with_either_library() -> None:
    options = FrankaOptions(compliance=Compliance(joints=(60.0,) * 7))
    for made in (PylibfrankaArm("192.0.2.1", FR3, options), FrankaArm("192.0.2.1", FR3, options)):
        assert (made.options.tracking_error, made.options.arrival) == (1.0, 0.05)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"speed": 1.01}, "speed is 1.01; valid: .*1"),
        ({"speed": 0}, "speed is 0"),
        ({"collision_torque": [100] * 6}, "a sequence of 7"),
        ({"collision_torque": [100] * 6 + [-1]}, "collision_torque"),
        ({"collision_force": -1}, "collision_force"),
        ({"whole_range": 1}, "whole_range"),
        ({"backend": "libfranka"}, "'franky', 'pylibfranka'"),
        ({"backend": "pylibfranka", "compliance": Compliance(tcp=(1000, 60))}, "TCP compliance needs the backend"),
        ({"sped": 0.5}, "Did you mean 'speed'"),
    ],
)
def test_an_option_of_an_fr3_that_is_none_is_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidSetup, match=words):
        FrankaDriver().arm("192.0.2.1", FR3, options)


def test_collision_thresholds_are_the_options_or_the_descriptions() -> None:
    assert FR3.collision is not None
    usual = FrankaOptions().thresholds(FR3)
    assert usual == (list(FR3.collision.joint_torque), [FR3.collision.force] * 3 + [FR3.collision.moment] * 3)
    given = FrankaOptions(collision_torque=(80.0,) * 7, collision_force=400.0)
    assert given.thresholds(FR3) == ([80.0] * 7, [400.0] * 6)


@pytest.mark.parametrize("is_still", [True, False])
@pytest.mark.parametrize("speed", [0.0, -0.5, 2.0 * AT_REST])
def test_an_xarm_has_braked_when_setpoints_and_joints_are_at_rest(is_still: bool, speed: float) -> None:
    arm: Any = XarmArm("192.0.2.1", XARM7, {})
    arm._api = SimpleNamespace(get_joint_states=lambda **_: (0, [[0.0] * 7, [0.0] * 6 + [speed]]))
    arm._ask = lambda call: call()
    arm._servo_to = lambda goal: None
    arm._ramp = SimpleNamespace(is_still=is_still)
    assert arm._brake_other() == (is_still and speed == 0.0)


def test_an_arm_whose_controller_refuses_its_tcp_does_not_start(monkeypatch: pytest.MonkeyPatch) -> None:
    tcp = {"tcp": [0, 0, 0.1, 0, 0, 0, 1]}
    xarm: Any = XarmArm("192.0.2.1", XARM7, tcp)
    xarm._ask = lambda call: call()
    xarm._api = SimpleNamespace(motion_enable=lambda _: 0, set_tcp_offset=lambda *_, **__: 10)
    with pytest.raises(DeviceFault, match=r"refuses the TCP .*option `tcp`"):
        xarm._enter(1)
    arm: Any = UrArm("192.0.2.1", UR5E, tcp)
    monkeypatch.setattr(ur, "require_ready_for_program", lambda _: None)
    monkeypatch.setattr(ur, "package_of", lambda *_: None)
    arm._receive = SimpleNamespace(getRuntimeState=lambda: 2)
    arm._control = SimpleNamespace(
        reuploadScript=lambda: True, isProgramRunning=lambda: True, setTcp=lambda _: False, setWatchdog=lambda _: True
    )
    with pytest.raises(DeviceFault, match=r"refuses the TCP .*option `tcp`"):
        arm._start_program()


def test_a_ur_connects_without_waiting_for_its_script_as_the_library_keeps_the_interpreter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[object] = []

    class Interface:
        FLAG_NO_WAIT = 16

        def __init__(self, _address: str, _rate: float, flags: int = 1) -> None:
            calls.append(flags)

        def reuploadScript(self) -> bool:  # noqa: N802  the library's
            calls.append("upload")
            return True

        def isProgramRunning(self) -> bool:  # noqa: N802
            return "upload" in calls

        def setWatchdog(self, _: float) -> bool:  # noqa: N802
            return True

    arm: Any = UrArm("192.0.2.1", UR5E, {})
    monkeypatch.setattr(ur, "require_ready_for_program", lambda _: None)
    monkeypatch.setattr(ur, "package_of", lambda *_: SimpleNamespace(RTDEControlInterface=Interface))
    arm._receive = SimpleNamespace(getRuntimeState=lambda: 2)
    arm._start_program()
    assert calls == [Interface.FLAG_NO_WAIT, "upload"]


def test_a_folder_of_hosts_that_cannot_be_used_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(hosted.FOLDER, str(tmp_path / "a" / "b"))
    assert hosted.folder().is_dir()
    monkeypatch.setenv(hosted.FOLDER, str(tmp_path / ("long" * 30)))
    with pytest.raises(InvalidSetup, match="too long for a socket; name a shorter folder in RCS_HOSTS"):
        _ = hosted.Place(driver="fake", address="x").socket
    (tmp_path / "file").touch()
    monkeypatch.setenv(hosted.FOLDER, str(tmp_path / "file" / "hosts"))
    with pytest.raises(InvalidSetup, match="cannot be made"):
        hosted.folder()


def test_a_servo_bus_waits_for_the_bytes_that_are_missing_yet() -> None:
    bus: Any = ServoBus("/dev/null", {1: "one", 2: "two", 3: "three"}, 0.1)
    waited: list[int] = []
    packets = [[255, 255, servo, 4, 0, 7, 8, 0] for servo in (1, 2, 3)]
    bus._port = SimpleNamespace(setPacketTimeoutMillis=lambda _: None)
    bus._packets = SimpleNamespace(rxPacket=lambda _: (packets.pop(0), 0))
    bus._wait = lambda count, deadline: waited.append(count)
    assert bus._answers([1, 2, 3], 2) == {servo: (0, bytes([7, 8])) for servo in (1, 2, 3)}
    assert waited == [24, 16, 8]


@pytest.mark.parametrize("kind", [FrankaArm, PylibfrankaArm])
def test_an_fr3_without_its_collision_thresholds_is_not_connected(kind: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise RuntimeError("the thresholds are refused")

    library = SimpleNamespace(
        RealtimeConfig=SimpleNamespace(Ignore=0, kIgnore=0),
        Robot=lambda *_, **__: SimpleNamespace(set_collision_behavior=refuse),
    )
    monkeypatch.setattr(f"{kind.__module__}.package_of", lambda *_: library)
    arm = kind("192.0.2.1", FR3, FrankaOptions())
    with pytest.raises(RuntimeError, match="thresholds"):
        arm._open()
    assert not arm._has_link  # the next recovery connects again
    arm._close()
    assert arm._robot is None


@pytest.mark.parametrize("has_stopped", [True, False])
def test_an_fr3_that_is_not_led_is_at_fault_when_the_controller_is(
    monkeypatch: pytest.MonkeyPatch, has_stopped: bool
) -> None:
    arm: Any = PylibfrankaArm("192.0.2.1", FR3, FrankaOptions())
    state = SimpleNamespace(
        q=np.zeros(7), dq=np.zeros(7), tau_J=[0.0] * 7, O_F_ext_hat_K=[0.0] * 6, time=SimpleNamespace(to_sec=time.time)
    )
    monkeypatch.setattr(franka_pylibfranka, "fault_of", lambda state, joints: "a reflex")
    monkeypatch.setattr(franka_pylibfranka, "mode_of", lambda state: "Reflex")
    arm._next_state = lambda: state
    arm._is_led = True
    if has_stopped:
        arm._stop()
    arm._read()
    assert ("a reflex" in str(arm.fault)) == has_stopped


def test_the_calibration_file_of_a_tilburg_hand_must_be_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    options, file = {"calibration": "~/left.json"}, tmp_path / "left.json"
    with pytest.raises(
        InvalidSetup, match=f"no calibration file {file.resolve()}; correct the option, or leave it out"
    ):
        TilburgDriver().hand("/dev/null", TILBURG_HAND, options)
    file.touch()
    hand: Any = TilburgDriver().hand("/dev/null", TILBURG_HAND, options)
    assert hand._calibration == str(file.resolve())
