"""The ports of a virtual xArm7, asked by plain sockets while its ticks are made by hand."""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from rcs import Setup
from rcs.errors import InvalidSetup, UnknownName
from rcs.kinematics import kinematics_of
from rcs.robots import XARM7
from rcs.virtual import VirtualWorld
from rcs.virtual.xarm_servo import RATE
from rcs.virtual.xarm_wire import XarmWire

ADDRESS = f"127.{192 + (os.getpid() >> 8) % 60}.{os.getpid() % 250 + 1}.1"
VERSION, ENABLE, SET_STATE, GET_STATE, GET_ERROR, CLEAN_ERROR, CLEAN_WARNING, SET_MODE = 1, 11, 12, 13, 15, 16, 17, 19
SERVO_JOINTS, SERVO_TCP, SET_TOOL, SENSITIVITY, TCP_POSE, JOINTS, TO_TOOL = 29, 30, 35, 37, 41, 42, 124
ERROR, WARNING, NOT_READY, REFUSED = 0x40, 0x20, 0x10, 0x08
MOVING, READY, STOPPED, CHANGED = 1, 2, 4, 5
CYCLE = 2 / RATE


def may_listen() -> bool:
    with socket.socket() as one:
        try:
            one.bind((ADDRESS, 502))
        except PermissionError:
            return False
    return True


pytestmark = pytest.mark.skipif(not may_listen(), reason="port 502 is for root, or net.ipv4.ip_unprivileged_port_start")


class Robot:
    """A virtual xArm7 whose time passes by hand, and a client of its port 502."""

    def __init__(self, end_effector: str = "robotiq_2f85") -> None:
        setup = Setup(task="Free", robot="xarm7", end_effector=end_effector)
        self.world = VirtualWorld(setup, address=ADDRESS)
        self.body = self.world.robots["xarm7"]
        wire = self.world.wires["xarm7"]
        assert isinstance(wire, XarmWire)
        self.wire = wire
        self.client = socket.create_connection((ADDRESS, 502))
        self.client.settimeout(1.0)
        self.pass_time(0.02)
        self.number = 0

    def pass_time(self, seconds: float) -> None:
        for _ in range(round(seconds * RATE)):
            self.body.line.flush()
            self.wire.tick(self.body)
            self.body.settle()
            self.world.world.advance()

    def tell(self, *words: str) -> None:
        self.world.tell(["", *words])

    def ask(self, function: int, values: bytes = b"") -> tuple[int, bytes]:
        """Send a command, have it answered at once, and return the state byte and values of the answer."""
        self.number += 1
        self.client.sendall(struct.pack(">3HB", self.number, 2, 1 + len(values), function) + values)
        for file in self.wire.files():
            self.wire.receive(file)
        head = self.client.recv(8, socket.MSG_WAITALL)
        number, protocol, size, answered, flags = struct.unpack(">3H2B", head)
        assert (number, protocol, answered) == (self.number, 2, function)
        return flags, self.client.recv(size - 2, socket.MSG_WAITALL) if size > 2 else b""

    def start(self, mode: int = 1) -> None:
        """Have the arm take points."""
        for function, values in ((ENABLE, [8, 1]), (SET_MODE, [mode]), (SET_STATE, [0])):
            self.ask(function, bytes(values))
        assert self.ask(GET_STATE) == (0, bytes([READY]))

    def lead(self, target: ArrayLike, seconds: float) -> None:
        """Lead the joints to a target at constant speed, a point per cycle."""
        start = self.joints()
        for share in np.linspace(0.0, 1.0, max(round(seconds / CYCLE), 1) + 1)[1:]:
            self.ask(SERVO_JOINTS, floats(start + share * (np.asarray(target) - start)))
            self.pass_time(CYCLE)

    def joints(self) -> NDArray[np.float64]:
        """Return where the joints are led."""
        return numbers(self.ask(JOINTS)[1])

    def error(self) -> int:
        return self.ask(GET_ERROR)[1][0]


def floats(values: ArrayLike) -> bytes:
    return np.asarray(values, "<f4").tobytes()


def numbers(data: bytes) -> NDArray[np.float64]:
    return np.frombuffer(data, "<f4").astype(np.float64)


@pytest.fixture
def robot() -> Iterator[Robot]:
    made = Robot()
    yield made
    made.client.close()
    made.world.close()


def test_what_is_told_is_what_the_world_has(robot: Robot) -> None:
    robot.start()
    robot.lead(np.array(XARM7.home) + 0.1, 0.2)
    _, values = robot.ask(JOINTS, bytes([3]))
    measured, velocities, torques = numbers(values).reshape(3, 7)
    assert measured == pytest.approx(robot.body.joints, abs=1e-6)
    assert velocities == pytest.approx(robot.body.velocities, abs=1e-5)
    assert torques == pytest.approx(robot.body.torques, rel=1e-3, abs=1e-3)
    pose = numbers(robot.ask(TCP_POSE)[1])
    flange = kinematics_of(XARM7).forward(robot.joints())
    assert pose[:3] == pytest.approx(1e3 * flange.translation, abs=0.01)


def test_the_arm_stands_until_it_is_enabled_has_a_mode_and_is_set_going(robot: Robot) -> None:
    before = robot.body.joints
    flags, state = robot.ask(GET_STATE)
    assert (flags, state) == (NOT_READY, bytes([STOPPED]))
    robot.ask(SERVO_JOINTS, floats(before + 0.01))
    robot.pass_time(0.1)
    assert robot.ask(SET_STATE, bytes([0]))[0] & REFUSED
    robot.ask(ENABLE, bytes([8, 1]))
    robot.ask(SET_MODE, bytes([1]))
    assert robot.ask(GET_STATE)[1] == bytes([CHANGED])
    assert robot.ask(SERVO_JOINTS, floats(before + 0.01))[0] & NOT_READY
    robot.pass_time(0.1)
    assert robot.body.joints == pytest.approx(before, abs=1e-3)
    assert robot.ask(SET_STATE, bytes([0]))[0] == 0
    robot.lead(before + 0.01, 0.05)
    assert robot.ask(GET_STATE)[1] == bytes([MOVING])
    robot.pass_time(0.5)
    assert robot.ask(GET_STATE)[1] == bytes([READY])
    assert robot.body.joints == pytest.approx(before + 0.01, abs=4e-3)


def test_only_the_newest_point_counts(robot: Robot) -> None:
    robot.start()
    start = robot.joints()
    robot.ask(SERVO_JOINTS, floats(start + 0.02))
    robot.ask(SERVO_JOINTS, floats(start + 0.001))
    robot.pass_time(0.1)
    assert robot.joints() == pytest.approx(start + 0.001, abs=1e-6)


def test_a_program_that_falls_silent_leaves_the_arm_at_its_last_point(robot: Robot) -> None:
    robot.start()
    start = robot.joints()
    robot.lead(start + 0.1, 0.25)
    robot.client.close()
    robot.pass_time(0.5)
    assert robot.body.joints == pytest.approx(start + 0.1, abs=5e-3)
    assert np.abs(robot.body.velocities).max() < 1e-2


@pytest.mark.parametrize(
    ("step", "seconds", "code"),
    [
        ([0, 0, 0, 0, 0, 0, 1.0], 0.0, 24),
        ([0, 0, 0, 0, 0, 0, 1.0], 0.25, 24),
        ([0, 0, 0, 0, 0, 0, 1.0], 0.4, 0),
        ([0, 2.5, 0, 0, 0, 0, 0], 0.0, 23),
        ([np.nan] * 7, 0.0, 23),
    ],
    ids=["a jump", "too fast", "fast", "out of range", "no number"],
)
def test_points_that_a_real_controller_does_not_follow_are_errors(
    robot: Robot, step: list[float], seconds: float, code: int
) -> None:
    robot.start()
    start = robot.body.joints
    robot.lead(robot.joints() + step, seconds)
    assert robot.error() == code
    if code:
        flags, state = robot.ask(GET_STATE)
        assert (flags, state) == (ERROR | NOT_READY, bytes([STOPPED]))
        robot.pass_time(0.5)
        assert np.abs(robot.body.velocities).max() < 1e-2
        assert (np.abs(robot.body.joints - start) < np.maximum(np.nan_to_num(np.abs(step)), 0.05)).all()


def test_a_tcp_that_is_too_fast_is_c60(robot: Robot) -> None:
    robot.start()
    robot.lead([0.0, 0.7, 0.0, 1.5, 0.0, 0.0, 0.0], 1.5)  # stretched out
    start = robot.joints()
    assert robot.error() == 0
    robot.lead(start + [1.2, 0, 0, 0, 0, 0, 0], 0.42)
    assert robot.error() == 60


def test_joints_that_do_not_follow_are_a_collision_at_the_sensitivity_that_is_set(robot: Robot) -> None:
    for sensitivity, code in ((0, 0), (5, 31)):
        robot.start()
        robot.ask(SENSITIVITY, bytes([sensitivity]))
        robot.body.limit(np.zeros(7))  # the motors are too weak
        robot.lead(robot.joints() + 0.25, 0.3)
        robot.pass_time(0.2)
        assert robot.error() == code
        robot.body.limit(np.ones(7))
        robot.ask(CLEAN_ERROR)
        robot.pass_time(1.0)


def test_an_error_stays_until_it_is_cleaned_and_cleaning_it_moves_nothing(robot: Robot) -> None:
    robot.start()
    robot.tell("code", "31")
    robot.tell("reflex")
    assert robot.ask(SET_STATE, bytes([0]))[0] & REFUSED
    robot.tell("clear")
    assert robot.error() == 31
    before = robot.body.joints
    robot.ask(CLEAN_ERROR)
    assert robot.error() == 0
    robot.pass_time(0.2)
    assert robot.ask(GET_STATE)[1] == bytes([STOPPED])
    assert robot.body.joints == pytest.approx(before, abs=1e-4)
    assert robot.ask(SET_STATE, bytes([0])) == (0, b"")  # the motors were on all the time


def test_an_emergency_stop_takes_the_power_and_stays_while_the_button_is_pressed(robot: Robot) -> None:
    robot.start()
    robot.tell("user_stop")
    robot.ask(CLEAN_ERROR)
    assert robot.error() == 1
    robot.tell("clear")
    robot.ask(CLEAN_ERROR)
    assert robot.error() == 0
    assert robot.ask(SET_STATE, bytes([0]))[0] & REFUSED
    robot.start()


def test_a_joint_that_is_overloaded_is_named_by_its_code(robot: Robot) -> None:
    robot.tell("overload", "joint4")
    assert robot.error() == 14


def test_a_pose_is_reached_on_a_straight_line(robot: Robot) -> None:
    robot.ask(SET_TOOL, floats([0, 0, 150, 0, 0, 0]))
    robot.start()
    start = numbers(robot.ask(TCP_POSE)[1])
    for way in np.linspace(0.0, 30.0, 50):
        robot.ask(SERVO_TCP, floats(start + [way, 0, -way, 0, 0, 0]))
        robot.pass_time(CYCLE)
        place = numbers(robot.ask(TCP_POSE)[1])[:3] - start[:3]
        assert place == pytest.approx([way, 0.0, -way], abs=0.05)
    assert robot.error() == 0
    robot.ask(SERVO_TCP, floats([3000, 0, 0, 0, 0, 0]))
    assert robot.error() == 21


def test_a_person_moves_the_arm_in_manual_mode(robot: Robot) -> None:
    robot.start(mode=2)
    before = robot.body.joints
    for _ in range(100):
        robot.pass_time(CYCLE)
        robot.body._data.xfrc_applied[robot.body._model.body("xarm7/link7").id, 1] = 30.0
    assert np.abs(robot.body.joints - before).max() > 0.02
    robot.body._data.xfrc_applied[...] = 0.0


def test_an_unknown_command_is_refused_with_a_warning(robot: Robot) -> None:
    assert robot.ask(99)[0] == WARNING | REFUSED | NOT_READY
    assert robot.ask(GET_ERROR)[1] == bytes([0, 13])
    robot.ask(CLEAN_WARNING)
    assert robot.ask(GET_ERROR)[1] == bytes([0, 0])
    assert robot.ask(SERVO_JOINTS, b"\0\0")[0] & REFUSED  # half a point


@pytest.mark.parametrize(
    ("function", "values"),
    [
        (ENABLE, b"\x00\x01"),
        (ENABLE, b"\x09\x01"),
        (SERVO_TCP, floats([np.nan] * 6)),
        (SET_TOOL, floats([np.inf] * 6)),
    ],
)
def test_values_that_make_no_sense_are_refused_and_change_nothing(robot: Robot, function: int, values: bytes) -> None:
    robot.start()
    before = robot.joints()
    assert robot.ask(function, values) == (REFUSED, b"")
    robot.pass_time(0.1)
    assert robot.ask(GET_STATE) == (0, bytes([READY]))
    assert robot.joints() == pytest.approx(before, abs=1e-3)


@pytest.mark.parametrize(("port", "size"), [(30001, 145), (30002, 288), (30003, 87)])
def test_reports_have_the_layout_of_the_manual(robot: Robot, port: int, size: int) -> None:
    with socket.create_connection((ADDRESS, port)) as listener:
        listener.settimeout(1.0)
        robot.start()
        robot.pass_time(0.25)
        report = listener.recv(size, socket.MSG_WAITALL)
    assert struct.unpack_from(">I", report)[0] == size == len(report)
    assert numbers(report[7:35]) == pytest.approx(robot.body.joints, abs=1e-3)
    assert numbers(report[35:47]) == pytest.approx(
        1e3 * kinematics_of(XARM7).forward(robot.body.joints).translation, abs=1.0
    )
    if size > 87:
        assert list(report[87:91]) == [0x7F, 0x7F, 0, 0]
        assert report[131] == 3
    if size > 145:
        assert list(report[145:147]) == [7, 7]
        assert report[151:181].startswith(b"v2.7.1\0")


def test_frames_reach_the_gripper_at_the_flange(robot: Robot) -> None:
    read = struct.pack(">2B2H", 9, 3, 0x07D0, 3)
    flags, values = robot.ask(TO_TOOL, bytes([9]) + read)
    assert not flags & REFUSED
    assert values[:4] == bytes([9, 9, 3, 6])
    assert values[4] >> 4 & 3 == 3  # activated
    close = struct.pack(">2B2HB3H", 9, 16, 0x03E8, 3, 6, 0x0900, 255, 255 << 8 | 255)
    robot.ask(TO_TOOL, bytes([9]) + close)
    robot.pass_time(1.0)
    assert robot.body.width < 0.01


def test_the_version_that_is_told_is_the_one_that_is_said(robot: Robot) -> None:
    robot.tell("version", "1.8.0")
    assert robot.ask(VERSION)[1].rstrip(b"\0") == b"7,7,XS1300,AC1300,v1.8.0"


def test_faults_that_make_no_sense_are_refused(robot: Robot) -> None:
    for words, error in (
        (("overload", "nose"), UnknownName),
        (("code", "0"), InvalidSetup),
        (("version", "new"), InvalidSetup),
        (("gripper", "99"), InvalidSetup),
        (("fall",), UnknownName),
    ):
        with pytest.raises(error):
            robot.tell(*words)
    assert robot.error() == 0


def test_two_robots_cannot_have_one_address(robot: Robot) -> None:
    with pytest.raises(InvalidSetup, match="502"):
        Robot()
