"""The controller of an xArm7, as its ports show it: commands on port 502, and its three streams of reports.

Clients see firmware 2.7.1. A command is a head of u16 number, u16 protocol, u16 length in network order, a function and
its values, floats with the lowest byte first; the answer repeats head and function, and has a state byte before its
values. Reports come on port 30001 (normal) and 30002 (rich) five times a second, on 30003 (real) a hundred times.

In servo mode, the controller leads the joints to the newest point that it got until the next one is due, without limits
of its own, and stops where a real one does: joints out of their range (C23) or too fast (C24), a TCP that is too fast
(C60), joints that do not follow (C31). The functions are those of the vendor's public SDK.
"""

from __future__ import annotations

import enum
import re
import struct
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.kinematics import IkOptions, IkStatus, kinematics_of
from rcs.spatial import Pose
from rcs.virtual.fault import Fault
from rcs.virtual.robotiq_wire import RobotiqWire
from rcs.virtual.tcp_port import TcpConnection, TcpPort
from rcs.virtual.virtual_robot import VirtualRobot
from rcs.virtual.wire import Wire, taken

RATE: Final = 500
"""Ticks per second [Hz]: two per cycle of the controller, which has 250 Hz."""
CYCLE: Final = 2
"""Ticks per cycle: what a point of no stream takes."""
LONGEST_GAP: Final = RATE // 25
"""Ticks between points up to which they are a stream, whose speed is kept; the vendor asks for 30 to 250 Hz."""
COMMAND_PORT, NORMAL_PORT, RICH_PORT, REAL_PORT = 502, 30001, 30002, 30003
REPORT_TICKS: Final = {NORMAL_PORT: RATE // 5, RICH_PORT: RATE // 5, REAL_PORT: RATE // 100}
"""How many ticks apart the reports of a port are."""
VERSION: Final = "2.7.1"
"""Of the firmware."""
JOINT_SPEED: Final = 1.02 * np.pi
"""Joint speed above which C24 comes [rad/s]: the vendor's 180 degrees/s, with 2 % for the rounding of floats."""
TCP_SPEED: Final = 1.2
"""TCP speed above which C60 comes in servo mode [m/s]: by the vendor, 1.2 times the largest speed of linear moves."""
WINDOW: Final = 20
"""Ticks over which the servos smooth points and speeds are measured, since points come early and late; ours."""
TRACKING_LIMIT: Final = 0.3
"""How far a joint may be from where it is led at the usual collision sensitivity of 3 [rad]; ours."""
BUSY_TICKS: Final = RATE // 5
"""For how long after a point the arm counts as moving; ours."""
TOOL_BUS: Final = 9
"""Number of the line RS-485 at the flange among those that the controller passes frames to."""

Vector = NDArray[np.float64]
_ONE_BRANCH = IkOptions(translation_tolerance=1e-6, rotation_tolerance=1e-6, restarts=0)


class State(enum.IntEnum):
    """What the controller says of itself; vendor's manual."""

    MOVING = 1
    READY = 2
    PAUSED = 3
    STOPPED = 4
    CHANGED = 5
    """A mode or a setting was changed: nothing moves until the state is set to 0."""


class Mode(enum.IntEnum):
    """The modes that this controller has."""

    POSITION = 0
    SERVO = 1
    MANUAL = 2


class Code(enum.IntEnum):
    """Errors of the controller that end a motion; vendor's manual."""

    BUTTON = 1
    SERVOS = 10
    JOINT_1 = 11
    KINEMATICS = 21
    RANGE = 23
    JOINT_SPEED = 24
    COLLISION = 31
    TCP_SPEED = 60


_HAS_ERROR, _HAS_WARNING, _NOT_READY, _REFUSED = 0x40, 0x20, 0x10, 0x08
_NO_SUCH_FUNCTION, _NO_SOLUTION = 13, 14
_MODEL = 7  # the number of an xArm7


class _Refusal(Exception):
    """What a command asks for cannot be."""


class XarmWire(Wire):
    """Speaks for one arm, and for a Robotiq gripper on the line at its flange."""

    rate: ClassVar[int] = RATE
    address: ClassVar[str] = "127.0.0.1"
    faults: ClassVar[Mapping[str, str]] = {
        "reflex": "",
        "user_stop": "",
        "overload": "JOINT",
        "undervoltage": "",
        "code": "N",
        "version": "N",
        "gripper": "CODE",
    }
    """A reflex is C31, `user_stop` the emergency stop's button (C1), an overloaded joint C11 to C17, undervoltage an
    error of the servos (C10); `version` is that of the firmware, such as 1.8.0, and `gripper` a code of the register
    FLT, where 0 stands for power that fails."""

    def __init__(self, robot: VirtualRobot, address: str) -> None:
        """Listen on all ports; the motors are off, and the brakes hold the arm.

        Args:
            robot: The arm.
            address: An IP address of this machine, which no other controller has: the ports are fixed.

        Raises:
            InvalidSetup: A port is taken, or port 502 needs rights that this user does not have.
        """
        self._address = address
        self._robot = robot
        self._lower, self._upper = np.array(robot.about.joint_lower), np.array(robot.about.joint_upper)
        self._flange = kinematics_of(robot.about)
        self._tool = Pose()
        self._load = [0.0] * 4
        self._sensitivity, self._teaching = 3, 3
        self._ticks = 0
        self._version = VERSION
        self._state, self._mode = State.STOPPED, Mode.POSITION
        self._enabled = 0
        self._error = self._warning = 0
        self._is_button_pressed = False
        self._goal: Vector | None = None
        self._pointed = -BUSY_TICKS
        self._reference = robot.joints
        self._gap = self._left = float(CYCLE)
        self._past: deque[Vector] = deque(maxlen=WINDOW)
        self._ports: dict[int, TcpPort] = {}
        self._gripper = None if robot.gripper is None else RobotiqWire(robot)
        try:
            for port in (COMMAND_PORT, *REPORT_TICKS):
                self._ports[port] = self._listen(port)
        except BaseException:
            self.close()
            raise
        self._functions: Mapping[int, Callable[[bytes], bytes]] = {
            1: lambda _: f"7,{_MODEL},XS1300,AC1300,v{self._version}".encode().ljust(40, b"\0"),
            11: self._enable,
            12: self._set_state,
            13: lambda _: bytes([self._state_now]),
            14: lambda _: bytes(2),
            15: lambda _: bytes([self._error, self._warning]),
            16: self._clean_error,
            17: self._clean_warning,
            19: self._set_mode,
            29: self._servo_joints,
            30: self._servo_tcp,
            35: self._set_tool,
            36: self._set_load,
            37: self._set_sensitivity,
            41: lambda _: _floats(self._pose(self._reference)),
            42: self._joints,
            124: self._pass_to_tool,
        }
        robot.brake()

    def _listen(self, port: int) -> TcpPort:
        try:
            return TcpPort(self._address, port)
        except PermissionError as err:
            raise InvalidSetup(
                f"A virtual xArm listens on port {port}, as the real one does, which this user may not: run it as root,"
                f" or permit it with: sudo sysctl -w net.ipv4.ip_unprivileged_port_start={COMMAND_PORT}"
            ) from err
        except OSError as err:
            raise taken("A virtual xArm", f"{self._address}:{port}", err) from err

    def site(self) -> Mapping[str, Mapping[str, Any]]:
        """Return how driver `xarm` reaches the arm and its gripper."""
        entry = {"driver": "xarm", "address": self._address}
        return {"arms": entry} if self._gripper is None else {"arms": entry, "grippers": entry}

    def files(self) -> Sequence[TcpConnection]:
        """Return the clients: they wait for each answer, so no tick may pass before it."""
        return [] if self._robot.line.is_cut else self._ports[COMMAND_PORT].connections

    def receive(self, file: TcpConnection) -> None:
        """Answer a client."""
        file.receive()
        self._serve(file)
        if not file.is_open:
            self._ports[COMMAND_PORT].connections.remove(file)

    def tick(self, robot: VirtualRobot) -> None:
        """Lead the arm for 2 ms, and report."""
        self._ticks += 1
        if not robot.line.is_cut:
            for port in self._ports.values():
                port.poll()
            for client in self._ports[COMMAND_PORT].connections:
                self._serve(client)
        if self._gripper is not None:
            self._gripper.serve()
        self._lead()
        for port, ticks in REPORT_TICKS.items():
            if self._ticks % ticks == 0 and (clients := self._ports[port].connections):
                report = self._report(port)
                for client in clients:
                    self._send(client, report)

    def close(self) -> None:
        """Close all ports."""
        for port in self._ports.values():
            port.close()
        if self._gripper is not None:
            self._gripper.close()

    # --- What happens to it ---

    def tell(self, fault: Fault) -> None:
        """Have one of `faults` happen.

        Raises:
            UnknownName: The robot has no such joint.
            InvalidSetup: A number makes no sense.
        """
        match fault.name:
            case "reflex":
                self._fail(Code.COLLISION, "told")
            case "user_stop":
                self._is_button_pressed = True
                self._fail(Code.BUTTON, "told")
            case "overload":
                self._fail(Code.JOINT_1 + self._robot.joint_of(fault.value), "told")
            case "undervoltage":
                self._fail(Code.SERVOS, "told")
            case "code":
                if not 1 <= fault.number <= 255:
                    raise InvalidSetup(f"The code is {fault.value!r}; valid is one from 1 to 255.")
                self._fail(int(fault.number), "told")
            case "version":
                if not re.fullmatch(r"\d+\.\d+\.\d+", fault.value):
                    raise InvalidSetup(f"The version is {fault.value!r}; valid is one such as 1.8.0.")
                self._version = fault.value
            case _:
                if self._gripper is None or not 0 <= fault.number <= 15:
                    raise InvalidSetup(
                        f"The code is {fault.value!r}; valid is one from 0 to 15, for a robot with a gripper."
                    )
                self._gripper.tell(int(fault.number))

    def clear(self) -> None:
        """Release the emergency stop's button; errors stay until a client cleans them."""
        self._version = VERSION
        self._is_button_pressed = False
        if self._gripper is not None:
            self._gripper.clear()

    def _fail(self, code: int, reason: str) -> None:
        """Stop for an error, which stays until it is cleaned; the first one counts."""
        if self._error:
            return
        self._error = code
        self._robot.note("error", code=code, reason=reason)
        if code < Code.KINEMATICS:  # a button or a servo: the motors lose their power
            self._enabled = 0
        self._stop(State.STOPPED)

    # --- Motion ---

    @property
    def _is_ready(self) -> bool:
        return self._state == State.READY and self._enabled == 0x7F

    @property
    def _state_now(self) -> State:
        is_moving = self._is_ready and self._ticks - self._pointed < BUSY_TICKS
        return State.MOVING if is_moving else self._state

    def _stop(self, state: State) -> None:
        self._state = state
        self._goal = None
        self._pointed = -BUSY_TICKS
        self._robot.brake()

    def _lead(self) -> None:
        """Go on to the newest point, and stop where a real controller does."""
        robot = self._robot
        if not self._is_ready:
            self._reference = robot.commanded
            return
        if self._mode == Mode.MANUAL:
            robot.push(np.zeros(robot.about.dof))
            self._reference = robot.joints
            return
        reference = self._reference
        if self._goal is not None and self._left > 0:
            reference = reference + (self._goal - reference) / max(self._left, 1.0)
            self._left -= 1
        speeds = (reference - self._past[0]) * RATE / WINDOW
        if self._goal is not None and (trouble := self._trouble_at(reference, speeds)):
            self._fail(*trouble)
        else:
            self._reference = reference
            self._past.append(reference)
            robot.lead(np.mean(self._past, axis=0), speeds)

    def _trouble_at(self, reference: Vector, speeds: Vector) -> tuple[Code, str] | None:
        """Return the error of leading the joints there, and what is said of it."""
        if (fastest := np.abs(speeds)).max() > JOINT_SPEED:
            return Code.JOINT_SPEED, f"joint {fastest.argmax() + 1} is too fast"
        way = self._place(reference) - self._place(self._past[0])
        if np.linalg.norm(way) * RATE / WINDOW > TCP_SPEED:
            return Code.TCP_SPEED, "the TCP is too fast"
        apart = np.abs(self._robot.commanded - self._robot.joints)
        if apart.max() * self._sensitivity > 3 * TRACKING_LIMIT:
            return Code.COLLISION, f"joint {apart.argmax() + 1} does not follow"
        return None

    def _place(self, joints: Vector) -> Vector:
        """Return where the TCP is [m]."""
        return (self._flange.forward(joints) * self._tool).translation

    def _pose(self, joints: Vector) -> Vector:
        """Return the pose of the TCP as the controller has it: mm, and roll, pitch, yaw [rad]."""
        pose = (self._flange.forward(joints) * self._tool).xyzrpy
        return np.concatenate([1e3 * pose[:3], pose[3:]])

    # --- Commands ---

    def _serve(self, client: TcpConnection) -> None:
        data = client.received
        while len(data) >= 6:
            number, protocol, size = struct.unpack_from(">3H", data)
            if len(data) < 6 + size:
                return
            body = bytes(data[6 : 6 + size])
            del data[: 6 + size]
            if size and body != b"\0\0":  # else a heartbeat
                answer = self._answer(body[0], body[1:])
                self._send(client, struct.pack(">3HB", number, protocol, 1 + len(answer), body[0]) + answer)

    def _send(self, client: TcpConnection, packet: bytes) -> None:
        """Send a packet; TCP drops a damaged one."""
        self._robot.line.send(packet, lambda passed: client.send(packet) if passed == packet else None)

    def _answer(self, function: int, values: bytes) -> bytes:
        """Do what a command says, and return the state byte and values."""
        refused = 0
        found = b""
        try:
            if function not in self._functions:
                self._warning = _NO_SUCH_FUNCTION
                raise _Refusal
            found = self._functions[function](values)
        except (_Refusal, struct.error, IndexError):
            refused = _REFUSED
        flags = refused | (_HAS_ERROR if self._error else 0) | (_HAS_WARNING if self._warning else 0)
        return bytes([flags | (0 if self._is_ready else _NOT_READY)]) + found

    def _enable(self, values: bytes) -> bytes:
        joints = 0x7F if values[0] == 8 else 1 << (values[0] - 1)
        if self._error and values[1]:
            raise _Refusal
        self._enabled = self._enabled | joints if values[1] else self._enabled & ~joints
        if not values[1]:
            self._stop(State.STOPPED)
        return b""

    def _set_state(self, values: bytes) -> bytes:
        if values[0] == 0:
            if self._error or self._enabled != 0x7F:
                raise _Refusal
            if self._state != State.READY:
                self._state, self._goal = State.READY, None
                self._reference = self._robot.commanded
                self._past.extend([self._reference] * WINDOW)
        elif values[0] in (State.PAUSED, State.STOPPED):
            self._stop(State(values[0]))
        else:
            raise _Refusal
        return b""

    def _set_mode(self, values: bytes) -> bytes:
        if values[0] not in list(Mode):
            raise _Refusal
        if self._mode == Mode.MANUAL and self._is_ready:
            self._robot.rest()
        self._mode = Mode(values[0])
        self._stop(State.STOPPED if self._error else State.CHANGED)
        return b""

    def _clean_error(self, values: bytes) -> bytes:
        if not self._is_button_pressed:
            self._error = 0
        return b""

    def _clean_warning(self, values: bytes) -> bytes:
        self._warning = 0
        return b""

    def _servo_joints(self, values: bytes) -> bytes:
        joints = np.array(struct.unpack_from("<7f", values), np.float64)
        self._robot.log_point(joints=joints)
        self._point(joints)
        return b""

    def _servo_tcp(self, values: bytes) -> bytes:
        given = np.array(struct.unpack_from("<6f", values), np.float64)
        pose = Pose.from_xyzrpy(np.concatenate([1e-3 * given[:3], given[3:]]))
        near = self._reference if self._goal is None else self._goal
        found = self._flange.inverse(pose * self._tool.inverse(), near, _ONE_BRANCH)
        if found.status != IkStatus.ok:
            self._fail(Code.KINEMATICS, "no joints for a pose")
        self._point(found.joints)
        return b""

    def _point(self, joints: Vector) -> None:
        """Take a point; the one before counts no more."""
        if self._error or not self._is_ready:
            return  # the state byte tells
        if self._mode != Mode.SERVO:
            raise _Refusal
        if ((joints >= self._lower - 1e-6) & (joints <= self._upper + 1e-6)).all():
            gap = self._ticks - self._pointed
            if gap:
                self._gap += 0.2 * (gap - self._gap) if gap < LONGEST_GAP else CYCLE - self._gap
                self._left = max(self._gap, CYCLE)
            self._goal = joints
            self._pointed = self._ticks
        else:
            self._fail(Code.RANGE, "a point is out of range")

    def _set_tool(self, values: bytes) -> bytes:
        given = np.array(struct.unpack_from("<6f", values), np.float64)
        self._tool = Pose.from_xyzrpy(np.concatenate([1e-3 * given[:3], given[3:]]))
        self._stop(State.STOPPED if self._error else State.CHANGED)
        return b""

    def _set_load(self, values: bytes) -> bytes:
        self._load = list(struct.unpack_from("<4f", values))
        return b""

    def _set_sensitivity(self, values: bytes) -> bytes:
        if values[0] > 5:
            raise _Refusal
        self._sensitivity = values[0]
        return b""

    def _joints(self, values: bytes) -> bytes:
        """Return where joints are led or, on a number of rows, what is measured: positions, velocities, torques."""
        if not values:
            return _floats(self._reference)
        rows = (self._robot.joints, self._robot.velocities, self._robot.torques)[: values[0] & 0x0F]
        return b"".join(_floats(row) for row in rows)

    def _pass_to_tool(self, values: bytes) -> bytes:
        """Pass a frame of Modbus RTU, without its checksum, to the gripper."""
        if self._gripper is None or values[0] != TOOL_BUS:
            raise _Refusal
        return bytes([TOOL_BUS]) + self._gripper.answer_frame(values[1:])

    # --- Reports ---

    def _report(self, port: int) -> bytes:
        """Return a report with its size before it; the layout is that of the vendor's manual."""
        robot = self._robot
        joints = robot.joints
        body = bytes([self._state_now | self._mode << 4]) + bytes(2)
        body += _floats(joints) + _floats(self._pose(joints)) + _floats(robot.torques)
        if port != REAL_PORT:
            brakes = 0x7F if self._enabled else 0  # 1 is released
            body += bytes([brakes, self._enabled, self._error, self._warning])
            tool = self._tool.xyzrpy
            body += _floats(np.concatenate([1e3 * tool[:3], tool[3:]])) + _floats(self._load)
            body += bytes([self._sensitivity, self._teaching]) + _floats([0.0, 0.0, -1.0])
        if port == RICH_PORT:
            about = robot.about
            body += bytes([_MODEL, 7, 0xAA, 0x55, 0, 0]) + f"v{self._version}".encode().ljust(30, b"\0")
            body += _floats([1e4, 0.1, 5e4, 0.1, 1e3])  # of the TCP: jerk, accelerations, speeds [mm]
            body += _floats([about.jerk_limit[0], 0.01, about.acceleration_limit[0], 1e-4, np.pi])  # of joints
            body += _floats([2.3, 2.7])  # of rotation: jerk, acceleration
            codes = [1 if self._error == Code.JOINT_1 + joint else 0 for joint in range(7)]
            body += bytes(byte for code in codes for byte in (2 if code else 0, code)) + bytes(2)
            body += bytes([35] * 7)  # temperatures
            speeds = robot.velocities
            body += _floats([0.0]) + _floats(speeds) + struct.pack(">I", 0)
        return struct.pack(">I", 4 + len(body)) + body


def _floats(values: Sequence[float] | Vector) -> bytes:
    return np.asarray(values, "<f4").tobytes()
