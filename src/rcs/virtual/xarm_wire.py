"""The ports of an xArm7 controller: commands on port 502, and three streams of reports.

Clients see firmware 2.7.1. Ports 30001 (normal) and 30002 (rich) send five reports a second, port 30003 (real) a
hundred. The functions are those of the vendor's public SDK.
"""

from __future__ import annotations

import re
import struct
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
from rcs.virtual.xarm_messages import (
    COMMAND_PORT,
    HAS_ERROR,
    HAS_WARNING,
    MODEL,
    NO_SUCH_FUNCTION,
    NOT_READY,
    REFUSED,
    REPORT_RATES,
    Code,
    Mode,
    State,
    answer_packet,
    floats,
    pose_of,
    pose_values,
    report,
    requests,
)
from rcs.virtual.xarm_servo import RATE, ServoMode

VERSION: Final = "2.7.1"
"""Version of the firmware."""
TOOL_BUS: Final = 9
"""Number of the RS-485 line at the flange in requests to pass a frame."""

Vector = NDArray[np.float64]
_ONE_BRANCH = IkOptions(translation_tolerance=1e-6, rotation_tolerance=1e-6, restarts=0)


class _Refusal(Exception):
    """A command that the controller refuses."""


class XarmWire(Wire):
    """Implements the interface of an arm and of a Robotiq gripper on the line at its flange."""

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
    """A reflex is C31, `user_stop` the emergency stop button (C1), an overloaded joint C11 to C17, undervoltage an
    error of the servos (C10); `version` is that of the firmware, such as 1.8.0, and `gripper` a code of the register
    FLT, with 0 for a power failure."""

    def __init__(self, robot: VirtualRobot, address: str) -> None:
        """Listen on all ports, with the motors off and the brakes engaged.

        Args:
            robot: The arm.
            address: An IP address of this machine that no other controller uses, since the ports are fixed.

        Raises:
            InvalidSetup: A port is taken, or the user lacks the permission to use port 502.
        """
        self._address = address
        self._robot = robot
        self._lower, self._upper = np.array(robot.about.joint_lower), np.array(robot.about.joint_upper)
        self._flange = kinematics_of(robot.about)
        self._tool = Pose()
        self._load = [0.0] * 4
        self._sensitivity = 3
        self._ticks = 0
        self._version = VERSION
        self._state, self._mode = State.STOPPED, Mode.POSITION
        self._enabled = 0
        self._error = self._warning = 0
        self._is_button_pressed = False
        self._servo = ServoMode(robot, lambda joints: (self._flange.forward(joints) * self._tool).translation)
        self._ports: dict[int, TcpPort] = {}
        self._gripper = None if robot.gripper is None else RobotiqWire(robot)
        try:
            for port in (COMMAND_PORT, *REPORT_RATES):
                self._ports[port] = self._listen(port)
        except BaseException:
            self.close()
            raise
        self._functions: Mapping[int, Callable[[bytes], bytes]] = {
            1: lambda _: f"7,{MODEL},XS1300,AC1300,v{self._version}".encode().ljust(40, b"\0"),
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
            41: lambda _: floats(self._pose(self._servo.reference)),
            42: self._joints,
            124: self._pass_to_tool,
        }
        robot.brake()

    def _listen(self, port: int) -> TcpPort:
        try:
            return TcpPort(self._address, port)
        except PermissionError as err:
            raise InvalidSetup(
                f"A virtual xArm needs port {port}, like a real one, but this user has no permission: run it as root,"
                f" or permit it by: sudo sysctl -w net.ipv4.ip_unprivileged_port_start={COMMAND_PORT}"
            ) from err
        except OSError as err:
            raise taken("A virtual xArm", f"{self._address}:{port}", err) from err

    def site(self) -> Mapping[str, Mapping[str, Any]]:
        """Return the site entries of the arm and its gripper for the driver `xarm`."""
        entry = {"driver": "xarm", "address": self._address}
        return {"arms": entry} if self._gripper is None else {"arms": entry, "grippers": entry}

    def files(self) -> Sequence[TcpConnection]:
        """Return the clients, which wait for each answer and must be served before the next tick."""
        return [] if self._robot.line.is_cut else self._ports[COMMAND_PORT].connections

    def receive(self, file: TcpConnection) -> None:
        """Answer a client."""
        file.receive()
        self._serve(file)
        if not file.is_open:
            self._ports[COMMAND_PORT].connections.remove(file)

    def tick(self, robot: VirtualRobot) -> None:
        """Move the arm for 2 ms and send reports."""
        self._ticks += 1
        self._servo.tick()
        if not robot.line.is_cut:
            for port in self._ports.values():
                port.poll()
            for client in self._ports[COMMAND_PORT].connections:
                self._serve(client)
        if self._gripper is not None:
            self._gripper.serve()
        self._lead()
        for port, rate in REPORT_RATES.items():
            if self._ticks % (RATE // rate) == 0 and (clients := self._ports[port].connections):
                report = self._report(port)
                for client in clients:
                    self._send(client, report)

    def close(self) -> None:
        """Close all ports."""
        for port in self._ports.values():
            port.close()
        if self._gripper is not None:
            self._gripper.close()

    # --- Faults ---

    def tell(self, fault: Fault) -> None:
        """Apply one of `faults`.

        Raises:
            UnknownName: The robot has no such joint.
            InvalidSetup: A value is invalid.
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
                    raise InvalidSetup(f"The code is {fault.value!r}; valid: 1 to 255.")
                self._fail(int(fault.number), "told")
            case "version":
                if not re.fullmatch(r"\d+\.\d+\.\d+", fault.value):
                    raise InvalidSetup(f"The version is {fault.value!r}; valid is a version such as 1.8.0.")
                self._version = fault.value
            case _:
                if self._gripper is None or not 0 <= fault.number <= 15:
                    raise InvalidSetup(
                        f"The code is {fault.value!r}; valid is one from 0 to 15, for a robot with a gripper."
                    )
                self._gripper.tell(int(fault.number))

    def clear(self) -> None:
        """Release the emergency stop button; errors remain until a client clears them."""
        self._version = VERSION
        self._is_button_pressed = False
        if self._gripper is not None:
            self._gripper.clear()

    def _fail(self, code: int, reason: str) -> None:
        """Stop with an error that remains until it is cleared; the first one counts."""
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
        return State.MOVING if self._is_ready and self._servo.is_moving else self._state

    def _stop(self, state: State) -> None:
        self._state = state
        self._servo.end()
        self._robot.brake()

    def _lead(self) -> None:
        """Move towards the newest setpoint, and stop under the conditions of a real controller."""
        if not self._is_ready:
            self._servo.reference = self._robot.commanded
        elif self._mode == Mode.MANUAL:
            self._robot.push(np.zeros(self._robot.about.dof))
            self._servo.reference = self._robot.joints
        elif trouble := self._servo.advance(self._sensitivity):
            self._fail(*trouble)

    def _pose(self, joints: Vector) -> Vector:
        """Return the pose of the TCP in the controller's format: translation [mm], and roll, pitch, yaw [rad]."""
        return pose_values(self._flange.forward(joints) * self._tool)

    # --- Commands ---

    def _serve(self, client: TcpConnection) -> None:
        for request in requests(client.received):
            answer = self._answer(request.function, request.values)
            self._send(client, answer_packet(request, answer))

    def _send(self, client: TcpConnection, packet: bytes) -> None:
        """Send a packet; TCP drops a damaged one."""
        self._robot.line.send(packet, lambda passed: client.send(packet) if passed == packet else None)

    def _answer(self, function: int, values: bytes) -> bytes:
        """Execute a command and return the state byte and values."""
        refused = 0
        found = b""
        try:
            if function not in self._functions:
                self._warning = NO_SUCH_FUNCTION
                raise _Refusal
            found = self._functions[function](values)
        except (_Refusal, struct.error, IndexError, ValueError):  # as for a pose that is not finite
            refused = REFUSED
        flags = refused | (HAS_ERROR if self._error else 0) | (HAS_WARNING if self._warning else 0)
        return bytes([flags | (0 if self._is_ready else NOT_READY)]) + found

    def _enable(self, values: bytes) -> bytes:
        if not 1 <= values[0] <= 8 or (self._error and values[1]):
            raise _Refusal
        joints = 0x7F if values[0] == 8 else 1 << (values[0] - 1)
        self._enabled = self._enabled | joints if values[1] else self._enabled & ~joints
        if not values[1]:
            self._stop(State.STOPPED)
        return b""

    def _set_state(self, values: bytes) -> bytes:
        if values[0] == 0:
            if self._error or self._enabled != 0x7F:
                raise _Refusal
            if self._state != State.READY:
                self._state = State.READY
                self._servo.start()
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
        pose = pose_of(values)
        found = self._flange.inverse(pose * self._tool.inverse(), self._servo.newest, _ONE_BRANCH)
        if found.status != IkStatus.ok:
            self._fail(Code.KINEMATICS, "no joints for a pose")
        self._point(found.joints)
        return b""

    def _point(self, joints: Vector) -> None:
        """Replace the setpoint."""
        if self._error or not self._is_ready:
            return  # the state byte reports it
        if self._mode != Mode.SERVO:
            raise _Refusal
        if ((joints >= self._lower - 1e-6) & (joints <= self._upper + 1e-6)).all():
            self._servo.take(joints)
        else:
            self._fail(Code.RANGE, "a point is out of range")

    def _set_tool(self, values: bytes) -> bytes:
        self._tool = pose_of(values)
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
        """Return the joints' reference or, for a given number of rows, measured positions, velocities and torques."""
        if not values:
            return floats(self._servo.reference)
        rows = (self._robot.joints, self._robot.velocities, self._robot.torques)[: values[0] & 0x0F]
        return b"".join(floats(row) for row in rows)

    def _report(self, port: int) -> bytes:
        return report(
            port,
            self._robot,
            state=self._state_now,
            mode=self._mode,
            pose=self._pose(self._robot.joints),
            enabled=self._enabled,
            error=self._error,
            warning=self._warning,
            tool=pose_values(self._tool),
            load=self._load,
            sensitivity=self._sensitivity,
            version=self._version,
        )

    def _pass_to_tool(self, values: bytes) -> bytes:
        """Pass a frame of Modbus RTU, without its checksum, to the gripper."""
        if self._gripper is None or values[0] != TOOL_BUS:
            raise _Refusal
        return bytes([TOOL_BUS]) + self._gripper.answer_frame(values[1:])
