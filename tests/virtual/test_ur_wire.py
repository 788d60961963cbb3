"""The ports of a virtual UR, asked by plain sockets while its ticks are made by hand."""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from rcs.errors import InvalidSetup, UnknownName
from rcs.virtual import VirtualWorld, usual_setup
from rcs.virtual.rtde_port import FORMATS
from rcs.virtual.ur_wire import RATE, UrWire

ADDRESS = f"127.{128 + (os.getpid() >> 8) % 64}.{os.getpid() % 250 + 1}.1"
SCRIPT = b"def rtde_control():\n  textmsg(1)\nend\n"
INPUTS = [f"input_double_register_{i}" for i in range(11)]
READY, DONE = 1, 2


class Robot:
    """A virtual UR5e whose time passes by hand."""

    def __init__(self) -> None:
        self.world = VirtualWorld(usual_setup("ur5e"), address=ADDRESS)
        self.body = self.world.robots["ur5e"]
        wire = self.world.wires["ur5e"]
        assert isinstance(wire, UrWire)
        self.wire = wire
        self.ticks = 0
        wire.controller.clock = lambda: self.ticks / RATE

    def pass_time(self, seconds: float) -> None:
        for _ in range(round(seconds * RATE)):
            self.ticks += 1
            self.body.line.flush()
            self.wire.tick(self.body)
            self.body.settle()
            self.world.world.advance()

    def tell(self, *words: str) -> None:
        self.world.tell(["", *words])


class Client:
    """A client of RTDE with a recipe of outputs and one of inputs."""

    def __init__(self, robot: Robot, *outputs: str) -> None:
        self.robot = robot
        self.socket = socket.create_connection((ADDRESS, 30004))
        self.socket.settimeout(1.0)
        robot.pass_time(0.02)
        assert self.ask("V", struct.pack(">H", 2)) == b"\x01"
        self.names = outputs
        types = self.ask("O", struct.pack(">d", 500.0) + ",".join(outputs).encode())[1:].decode().split(",")
        self.formats = [FORMATS[kind] for kind in types]
        assert self.ask("S", b"") == b"\x01"

    def ask(self, kind: str, body: bytes) -> bytes:
        self.send(kind, body)
        self.robot.pass_time(0.01)
        while True:
            answer, found = self.receive()
            if answer == kind:
                return found

    def send(self, kind: str, body: bytes) -> None:
        self.socket.sendall(struct.pack(">HB", 3 + len(body), ord(kind)) + body)

    def receive(self) -> tuple[str, bytes]:
        size, kind = struct.unpack(">HB", self._exactly(3))
        return chr(kind), self._exactly(size - 3)

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            data += self.socket.recv(count - len(data))
        return data

    def outputs(self) -> dict[str, Any]:
        """Return the outputs of the next tick."""
        self.socket.setblocking(False)
        try:
            while self.socket.recv(65536):
                pass
        except BlockingIOError:
            self.socket.settimeout(1.0)
        self.robot.pass_time(1 / RATE)
        kind, body = self.receive()
        assert kind == "U"
        values, at = {}, 1
        for name, form in zip(self.names, self.formats, strict=True):
            found = struct.unpack_from(">" + form, body, at)
            at += struct.calcsize(">" + form)
            values[name] = found[0] if len(found) == 1 else np.array(found)
        return values


class Commander(Client):
    """A client that commands as the library ur_rtde does, after it has uploaded its script."""

    def __init__(self, robot: Robot, *outputs: str) -> None:
        super().__init__(robot, "output_int_register_0", "runtime_state", *outputs)
        answer = self.ask("I", ",".join(["input_int_register_0", *INPUTS, ""]).encode())
        assert b"IN_USE" not in answer
        self.recipe = answer[:1]
        self.upload(SCRIPT)

    def upload(self, script: bytes, port: int = 30002) -> None:
        with socket.create_connection((ADDRESS, port)) as sender:
            sender.sendall(script[:20])
            self.robot.pass_time(0.02)
            sender.sendall(script[20:])
            self.robot.pass_time(0.02)

    def command(self, number: int, *values: float) -> None:
        given = [*values, *[0.0] * (11 - len(values))]
        self.send("U", self.recipe + struct.pack(">i11d", number, *given))
        self.robot.pass_time(1 / RATE)

    def execute(self, number: int, *values: float, seconds: float = 5.0) -> None:
        """Command something that ends by itself, and wait for its end."""
        self.command(0)
        self.command(number, *values)
        for _ in range(round(seconds * RATE)):
            if self.outputs()["output_int_register_0"] == DONE:
                return
        raise AssertionError(f"command {number} is not done after {seconds} s")


@pytest.fixture
def robot() -> Iterator[Robot]:
    made = Robot()
    yield made
    made.world.close()


def dashboard(robot: Robot, *lines: str) -> list[str]:
    with socket.create_connection((ADDRESS, 29999)) as client:
        client.settimeout(1.0)
        answers = client.makefile("r")
        robot.pass_time(0.02)
        assert "Universal Robots" in answers.readline()
        client.sendall("".join(f"{line}\n" for line in lines).encode())
        robot.pass_time(0.01)
        return [answers.readline().strip() for _ in lines]


def test_outputs_are_what_the_world_has(robot: Robot) -> None:
    client = Client(robot, "timestamp", "actual_q", "actual_TCP_pose", "robot_mode", "safety_mode", "joint_mode")
    before, after = client.outputs(), client.outputs()
    assert after["timestamp"] - before["timestamp"] == pytest.approx(1 / RATE)
    assert after["actual_q"] == pytest.approx(robot.body.joints, abs=1e-9)
    assert after["actual_TCP_pose"][:3] == pytest.approx(robot.body.pose_tcp_in_base[:3], abs=1e-6)
    assert (after["robot_mode"], after["safety_mode"]) == (7, 1)
    assert (after["joint_mode"] == 253).all()


def test_names_that_are_not_known_are_not_found_and_nothing_starts(robot: Robot) -> None:
    client = Client(robot, "timestamp")
    assert client.ask("O", struct.pack(">d", 500.0) + b"timestamp,actual_r,") == b"\x00DOUBLE,NOT_FOUND"
    assert client.ask("S", b"") == b"\x00"
    assert client.ask("I", b"input_int_register_99") == b"\x00NOT_FOUND"


def test_inputs_belong_to_one_client_until_it_is_gone(robot: Robot) -> None:
    first, second = Client(robot, "timestamp"), Client(robot, "timestamp")
    assert first.ask("I", b"input_int_register_0,input_double_register_0")[1:] == b"INT32,DOUBLE"
    assert second.ask("I", b"input_double_register_0")[1:] == b"IN_USE"
    first.socket.close()
    robot.pass_time(0.02)
    assert second.ask("I", b"input_double_register_0")[1:] == b"DOUBLE"


def test_other_versions_are_refused_as_told(robot: Robot) -> None:
    client = Client(robot, "timestamp")
    robot.tell("version", "1")
    assert client.ask("V", struct.pack(">H", 2)) == b"\x00"
    assert client.ask("V", struct.pack(">H", 1)) == b"\x01"


def test_joints_are_followed(robot: Robot) -> None:
    client = Commander(robot, "actual_q")
    start = robot.body.joints
    for step in range(200):
        client.command(11, *(start - 0.1 * min(step / 100, 1.0)), 0, 0, 0.002, 0.05, 1600.0)
    robot.pass_time(0.3)
    assert client.outputs()["actual_q"] == pytest.approx(start - 0.1, abs=5e-3)
    assert client.outputs()["runtime_state"] == 2


def test_two_kinds_of_motion_at_once_end_the_program(robot: Robot) -> None:
    client = Commander(robot)
    client.command(11, *robot.body.joints, 0, 0, 0.002, 0.05, 1600.0)
    client.command(10, 0.01, 0, 0, 0, 0, 0, 0.5)
    assert client.outputs()["runtime_state"] == 1
    assert client.outputs()["output_int_register_0"] == READY  # of the program that has ended


@pytest.mark.parametrize("command", [9, 10, 11, 24])
def test_arguments_that_are_no_numbers_end_the_program_and_move_nothing(robot: Robot, command: int) -> None:
    client = Commander(robot)
    client.command(command, *[np.nan] * 6, 0.1, 0.1, 0.0, 0.1, 100.0)
    before = robot.body.joints
    robot.pass_time(0.2)
    assert not robot.wire.controller.is_running
    assert robot.body.joints == pytest.approx(before, abs=1e-4)


def test_a_program_of_which_nothing_is_heard_is_ended_by_its_watchdog(robot: Robot) -> None:
    client = Commander(robot, "target_qd")
    client.execute(35, 20.0)
    for _ in range(100):
        client.command(9, 0.5, 0, 0, 0, 0, 0, 4.0)
    assert client.outputs()["target_qd"][0] == pytest.approx(0.5, rel=0.4)
    robot.pass_time(0.04)
    assert client.outputs()["runtime_state"] == 2
    robot.pass_time(0.02)
    assert client.outputs()["runtime_state"] == 1
    robot.pass_time(0.1)
    assert not client.outputs()["target_qd"].any()


def test_a_joint_that_would_be_too_fast_is_a_protective_stop_that_names_it(robot: Robot) -> None:
    client = Commander(robot, "safety_mode", "joint_mode", "target_qd")
    before = robot.body.joints
    client.command(11, *(before + [0, 0, 0, 0, 1.5, 0]), 0, 0, 0.002, 0.03, 2000.0)
    robot.pass_time(0.05)
    seen = client.outputs()
    assert (seen["safety_mode"], seen["runtime_state"]) == (3, 1)
    assert seen["joint_mode"].tolist() == [253, 253, 253, 253, 252, 253]
    robot.pass_time(1.0)
    assert not client.outputs()["target_qd"].any()
    assert np.abs(robot.body.joints - before).max() < 0.8


def test_a_protective_stop_is_unlocked_after_five_seconds_and_nothing_moves(robot: Robot) -> None:
    robot.tell("protective_stop")
    before = robot.body.joints
    status, answer = dashboard(robot, "safetystatus", "unlock protective stop")
    assert status == "Safetystatus: PROTECTIVE_STOP"
    assert "until 5s" in answer
    robot.pass_time(5.0)
    assert dashboard(robot, "unlock protective stop", "safetystatus") == [
        "Protective stop releasing",
        "Safetystatus: NORMAL",
    ]
    assert robot.body.joints == pytest.approx(before, abs=1e-4)


def test_a_program_starts_on_no_arm_that_is_stopped(robot: Robot) -> None:
    client = Commander(robot)
    robot.tell("user_stop")
    client.upload(SCRIPT, 30001)
    assert client.outputs()["runtime_state"] == 1
    assert dashboard(robot, "robotmode", "safetystatus") == [
        "Robotmode: POWER_OFF",
        "Safetystatus: ROBOT_EMERGENCY_STOP",
    ]
    robot.tell("clear")
    client.upload(SCRIPT, 30003)
    assert client.outputs()["runtime_state"] == 2


def test_another_script_than_that_of_the_library_is_not_run(robot: Robot) -> None:
    client = Commander(robot)
    client.upload(b"def mine():\n  movej([0,0,0,0,0,0])\nend\n")
    assert client.outputs()["runtime_state"] == 1


def test_what_the_dashboard_does_not_know_it_says(robot: Robot) -> None:
    assert dashboard(robot, "dance", "running") == ["could not understand: 'dance'", "Program running: false"]


def test_faults_that_make_no_sense_are_refused(robot: Robot) -> None:
    for words, error in (
        (("overload", "nose"), UnknownName),
        (("gripper", "99"), InvalidSetup),
        (("fall",), UnknownName),
    ):
        with pytest.raises(error):
            robot.tell(*words)


def test_two_robots_cannot_have_one_address(robot: Robot) -> None:
    with pytest.raises(InvalidSetup, match="29999"):
        Robot()
