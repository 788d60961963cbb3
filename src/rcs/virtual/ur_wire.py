"""The controller of a UR e-series arm, as its ports show it: RTDE, dashboard, script ports, and what is behind them.

Clients see PolyScope 5.16 in remote control. RTDE (port 30004) sends outputs at up to 500 Hz; the dashboard (29999)
takes lines of text; the script ports (30001 to 30003) take the control script of ur_rtde and nothing else. That script
is not run but followed: a command in `input_int_register_0`, its arguments in the double registers, its state in
`output_int_register_0`.

The wire leads the joints of a robot that is behind it, tick by tick, and stops them for the reasons for which a real
controller does: joint speed and range, a path that the joints do not follow, a program that ends, a watchdog.
"""

from __future__ import annotations

import enum
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.kinematics import kinematics_of
from rcs.spatial import Pose
from rcs.virtual.fault import Fault
from rcs.virtual.robotiq_wire import RobotiqWire
from rcs.virtual.rtde_port import VERSION, Output, RtdePort
from rcs.virtual.tcp_port import TcpConnection, TcpPort
from rcs.virtual.ur_motion import (
    Chain,
    Motion,
    Move,
    ProgramError,
    Reference,
    Servo,
    SpeedJoints,
    SpeedTcp,
    Stop,
    pose_of,
    vector_of,
)
from rcs.virtual.virtual_robot import VirtualRobot
from rcs.virtual.wire import Wire, taken

RATE: Final = 500
"""Ticks of the controller per second [Hz]."""
SOFTWARE: Final = (5, 16, 0, 1110000)
"""Version of PolyScope."""
UNLOCK_AFTER: Final = 5.0
"""How long a protective stop lasts before the dashboard unlocks it [s]; vendor's Dashboard Server manual."""
SPEED_LIMIT: Final = np.deg2rad(191.0)
"""Joint speed at which the safety system stops the arm [rad/s]; its factory setting, 11 degrees/s above the rated."""
TRACKING_LIMIT: Final = 0.3
"""How far a joint may be from where it is led before the arm stops [rad]; ours, for the vendor publishes none."""
STOP_DECELERATION: Final = 10.0
"""Of the joints in a protective stop and when a program ends [rad/s²]; ours."""

Vector = NDArray[np.float64]


class RobotMode(enum.IntEnum):
    """RTDE's `robot_mode`."""

    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    RUNNING = 7


class SafetyMode(enum.IntEnum):
    """RTDE's `safety_mode`."""

    NORMAL = 1
    PROTECTIVE_STOP = 3
    SAFEGUARD_STOP = 5
    ROBOT_EMERGENCY_STOP = 7
    FAULT = 9


_SAFETY_BITS = {
    SafetyMode.NORMAL: 1 << 0,
    SafetyMode.PROTECTIVE_STOP: 1 << 2 | 1 << 10,
    SafetyMode.SAFEGUARD_STOP: 1 << 4 | 1 << 10,
    SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7 | 1 << 10,
    SafetyMode.FAULT: 1 << 9 | 1 << 10,
}
_JOINT_RUNNING, _JOINT_FAULT, _JOINT_POWER_OFF = 253, 252, 238

_READY, _DONE = 1, 2
_REAL_TIME = (9, 10, 11, 24)


@dataclass
class _Program:
    """The control script while it runs."""

    blocking: Callable[[], bool] | None = None
    """Of a command that takes time: whether it is done."""
    is_executing: bool = False
    """The present command has been carried out, and its register is not cleared yet."""
    watchdog: float = 0.0
    """How long the command register may stay unset before the program stops [s]; 0 for ever."""
    heard: float = 0.0
    """When the command register was set last, on the controller's clock [s]."""
    move: Motion | None = None
    """The motion that the program has asked for."""
    has_freedrive: bool = False


@dataclass
class _Registers:
    """What the program shows its client."""

    integers: list[int] = field(default_factory=lambda: [0] * 48)
    doubles: list[float] = field(default_factory=lambda: [0.0] * 48)


class UrWire(Wire):
    """Speaks for one arm, and for a Robotiq gripper on its flange."""

    rate: ClassVar[int] = RATE
    address: ClassVar[str] = "127.0.0.1"
    faults: ClassVar[Mapping[str, str]] = {
        "protective_stop": "",
        "reflex": "",
        "user_stop": "",
        "overload": "JOINT",
        "undervoltage": "",
        "power_off": "",
        "version": "N",
        "gripper": "CODE",
    }
    """A reflex and an overloaded joint end in a protective stop; `user_stop` is the emergency stop's button, `version`
    is that of RTDE, and `gripper` a code of the register FLT, where 0 stands for power that fails."""

    def __init__(self, robot: VirtualRobot, address: str) -> None:
        """Listen on all ports; the arm is powered on, its brakes are released, and no program runs.

        Args:
            robot: The arm; the TCP of the installation is that of its gripper.
            address: An IP address of this machine, which no other controller has: the ports are fixed. With the path of
                a serial line after a comma, the gripper speaks Modbus RTU there; else it is on the URCap's socket.

        Raises:
            InvalidSetup: A port is taken.
        """
        self._address, _, serial = address.partition(",")
        self._serial = serial
        self._robot = robot
        self._about = robot.about
        self._lower, self._upper = np.array(robot.about.joint_lower), np.array(robot.about.joint_upper)
        flange = kinematics_of(robot.about)
        tcp = kinematics_of(robot.about, robot.gripper)
        home = np.array(robot.about.home)
        self._chain = Chain(flange, flange.forward(home).inverse() * tcp.forward(home))
        self._ticks = 0
        self.clock: Callable[[], float] = time.monotonic
        """The controller's clock [s]."""
        self._thawed = 0.0
        self._reference = Reference(robot.joints)
        self._robot_mode = RobotMode.RUNNING
        self._safety_mode = SafetyMode.NORMAL
        self._bad_joint: int | None = None
        self._stopped_at = 0.0
        self._program: _Program | None = None
        self._stop: Stop | None = None
        self._registers = _Registers()
        self._payload = 0.0
        self._ports: list[TcpPort] = []
        self._gripper: RobotiqWire | None = None
        try:
            self._dashboard = self._listen(29999)
            self._scripts = [self._listen(port) for port in (30001, 30002, 30003)]
            self._rtde = RtdePort(self._listen(30004), robot.line, self._outputs(), SOFTWARE, RATE)
            self._rtde.heed = self._log_point
            if robot.gripper is not None and serial:
                self._gripper = RobotiqWire(robot, serial=Path(serial))
            elif robot.gripper is not None:
                self._gripper = RobotiqWire(robot, self._listen(63352))
        except BaseException:
            self.close()
            raise

    def _listen(self, port: int) -> TcpPort:
        try:
            self._ports.append(TcpPort(self._address, port))
        except OSError as err:
            raise taken("A virtual UR", f"{self._address}:{port}", err) from err
        return self._ports[-1]

    @property
    def is_running(self) -> bool:
        """Whether a program runs."""
        return self._program is not None

    def site(self) -> Mapping[str, Mapping[str, Any]]:
        """Return how driver `ur` reaches the arm and `robotiq` its gripper."""
        found = {"arms": {"driver": "ur", "address": self._address}}
        if self._gripper is not None:
            found["grippers"] = {"driver": "robotiq", "address": self._serial or self._address}
        return found

    def tick(self, robot: VirtualRobot) -> None:
        """Serve the ports and lead the arm for 2 ms."""
        self._ticks += 1
        self._rtde.was_set.clear()
        if robot.frozen_until > self._thawed:
            self._thawed = robot.frozen_until
            if self._program is not None and self._program.watchdog:
                self._end_program("watchdog, after the controller had hung")
        if not robot.line.is_cut:
            self._rtde.receive()
            self._serve_dashboard()
            self._serve_scripts()
            if self._gripper is not None:
                self._gripper.serve()
        self._run()
        self._lead()
        self._rtde.send(self._ticks)

    def close(self) -> None:
        """Close all ports."""
        for port in self._ports:
            port.close()
        if self._gripper is not None:
            self._gripper.close()

    @staticmethod
    def next_address(address: str) -> str:
        """Return the IP address after this one, and another serial line."""
        ip, comma, serial = address.partition(",")
        return f"{Wire.next_address(ip)}{comma}{serial and serial + '-next'}"

    # --- What happens to it ---

    def tell(self, fault: Fault) -> None:
        """Have one of `faults` happen.

        Raises:
            UnknownName: The robot has no such joint.
            InvalidSetup: A number makes no sense.
        """
        match fault.name:
            case "protective_stop":
                self._protect("asked for")
            case "reflex":
                self._protect("collision")
            case "user_stop":
                self._switch_off(SafetyMode.ROBOT_EMERGENCY_STOP)
            case "overload":
                self._protect("is overloaded", self._robot.joint_of(fault.value))
            case "undervoltage":
                self._switch_off(SafetyMode.FAULT)
            case "power_off":
                self._switch_off(self._safety_mode)
            case "version":
                self._rtde.version = int(fault.number)
            case _:
                if self._gripper is None or not 0 <= fault.number <= 15:
                    raise InvalidSetup(
                        f"The code is {fault.value!r}; valid is one from 0 to 15, for a robot with a gripper."
                    )
                self._gripper.tell(int(fault.number))

    def clear(self) -> None:
        """Mend what a person mends at the pendant: buttons, power, the safety system; a protective stop stays."""
        self._rtde.version = VERSION
        if self._gripper is not None:
            self._gripper.clear()
        if self._safety_mode != SafetyMode.PROTECTIVE_STOP:
            self._safety_mode, self._bad_joint = SafetyMode.NORMAL, None
        if self._robot_mode != RobotMode.RUNNING:
            self._robot_mode = RobotMode.RUNNING
            self._stand()

    def _protect(self, reason: str, joint: int | None = None) -> None:
        """Stop for a reason that the dashboard can unlock; a joint is what it is about."""
        if self._safety_mode == SafetyMode.NORMAL:
            self._bad_joint = joint
            reason = reason if joint is None else f"{self._about.joints[joint]} {reason}"
            self._robot.note("protective_stop", reason=reason)
            self._safety_mode = SafetyMode.PROTECTIVE_STOP
            self._stopped_at = self.clock()
            self._end_program(f"protective stop: {reason}")

    def _switch_off(self, safety_mode: SafetyMode) -> None:
        self._end_program(f"switched off, {safety_mode.name}")
        self._safety_mode = safety_mode
        self._robot_mode = RobotMode.POWER_OFF

    # --- Motion ---

    def _lead(self) -> None:
        """Move the reference by one tick, and the arm with it."""
        dt = 1 / RATE
        if self._robot_mode != RobotMode.RUNNING:
            self._robot.brake()
            self._stand()
            return
        program = self._program
        if program is not None and program.has_freedrive:
            self._robot.push(np.zeros(6))
            self._stand()
            return
        motion = self._stop or (None if program is None else program.move)
        if motion is None:
            self._reference.rest()
        else:
            try:
                is_over = motion.step(self._reference, dt)
            except ProgramError as err:
                self._end_program(str(err))
                is_over = False
            if is_over and motion is self._stop:
                self._stop = None
            elif is_over and program is not None:
                program.move = None
            self._watch()
        reference = self._reference
        self._robot.lead(reference.joints, reference.velocities, reference.accelerations)

    def _watch(self) -> None:
        """Stop the arm where a real controller does."""
        reference = self._reference
        speeds = np.abs(reference.velocities)
        if speeds.max() > SPEED_LIMIT:
            reference.velocities = np.clip(reference.velocities, -SPEED_LIMIT, SPEED_LIMIT)
            self._protect("is too fast", int(speeds.argmax()))
        inside = np.clip(reference.joints, self._lower, self._upper)
        if (inside != reference.joints).any():
            outside = inside != reference.joints
            reference.joints = inside
            reference.velocities = np.where(outside, 0.0, reference.velocities)
            self._protect("is at the end of its range", int(outside.argmax()))
        apart = np.abs(reference.joints - self._robot.joints)
        if apart.max() > TRACKING_LIMIT:
            self._protect("does not follow its path", int(apart.argmax()))

    def _stand(self) -> None:
        """Lead the arm from where it is."""
        self._reference = Reference(self._robot.joints)
        self._stop = None

    def _end_program(self, reason: str) -> None:
        """End the program; a motion brakes."""
        if self._program is not None:
            self._robot.note("program_ends", reason=reason)
            if self._program.has_freedrive:
                self._stand()
            self._program = None
        if self._reference.velocities.any():
            self._stop = Stop(STOP_DECELERATION)

    # --- The control script ---

    def _run(self) -> None:
        """Go once through the script's main loop."""
        program = self._program
        if program is None:
            return
        if "input_int_register_0" in self._rtde.was_set:
            program.heard = self.clock()
        elif 0 < program.watchdog < self.clock() - program.heard:
            self._end_program("watchdog")
            return
        integers = self._registers.integers
        command = self._rtde.registers["input_int_register_0"]
        try:
            if command in _REAL_TIME:
                self._start_real_time(program, command)
                integers[0] = _READY
            elif command == 0:
                program.is_executing, program.blocking = False, None
                integers[0] = _READY
            elif not program.is_executing:
                program.is_executing = True
                program.blocking = self._execute(program, command)
            if program.blocking is not None and program.blocking():
                program.blocking = None
                integers[0] = _DONE
        except ProgramError as err:
            self._end_program(str(err))

    def _doubles(self, first: int, count: int) -> Vector:
        """Return input registers."""
        registers = self._rtde.registers
        return np.array([registers[f"input_double_register_{i}"] for i in range(first, first + count)])

    def _log_point(self) -> None:
        if self._rtde.registers["input_int_register_0"] == 11:
            self._robot.log_point(joints=self._doubles(0, 6))

    def _start_real_time(self, program: _Program, command: int) -> None:
        """Take a command that the client repeats as fast as it likes."""
        values = self._doubles(0, 11)
        allowed = Servo if command in (11, 24) else SpeedJoints | SpeedTcp
        if program.move is not None and not isinstance(program.move, allowed):
            raise ProgramError("Another thread is already controlling the robot")
        if command in (11, 24):
            target = values[:6] if command == 11 else self._chain.inverse(pose_of(values), self._reference.joints)
            if isinstance(program.move, Servo):
                program.move.target, program.move.lookahead, program.move.gain = target, values[9], values[10]
            else:
                program.move = Servo(target, values[9], values[10])
        elif command == 9:
            program.move = SpeedJoints(values[:6], values[6])
        elif isinstance(program.move, SpeedTcp):
            program.move.twist, program.move.acceleration = values[:6], values[6]
        else:
            program.move = SpeedTcp(values[:6], values[6], self._chain)

    def _execute(self, program: _Program, command: int) -> Callable[[], bool]:
        """Begin a command and return what tells whether it is done.

        Raises:
            ProgramError: There is no such command, or it asks for what cannot be.
        """
        values = self._doubles(0, 14)
        now = self._reference.joints
        match command:
            case 1 | 2 | 3 | 4:
                goal: Vector | Pose = values[:6]
                if command in (2, 3):
                    goal = pose_of(values)
                if command == 2:
                    goal = self._chain.inverse(pose_of(values), now)
                elif command == 4:
                    goal = self._chain.forward(values[:6])
                program.move = Move(now, goal, values[6], values[7], self._chain)
                return lambda: self._rtde.registers["input_int_register_1"] == 1 or program.move is None
            case 15 | 16 | 33 | 34:
                # The linear stops brake along the joints, too; on a straight line they would leave it by little.
                program.move = Stop(STOP_DECELERATION if command == 16 else min(values[0], STOP_DECELERATION))
                return lambda: program.move is None
            case 17:
                self._payload = values[0]
            case 18 | 52:
                program.move, program.has_freedrive = None, True
            case 19 | 53:
                program.has_freedrive = False
            case 29:
                self._chain.tcp_in_flange = pose_of(values)
            case 31:
                self._protect("asked for by the program")
            case 35:
                program.watchdog, program.heard = 1 / values[0], self.clock()
            case 36 | 37:
                joints = values[:6] if command == 37 else self._chain.inverse(pose_of(values), now)
                is_inside = (joints >= self._lower).all() and (joints <= self._upper).all()
                self._registers.integers[1] = int(is_inside)
            case 40:
                self._registers.doubles[:6] = vector_of(self._chain.tcp_in_flange)
            case 43:
                self._registers.doubles[:6] = vector_of(self._chain.forward(now))
            case 30 | 46:
                near = values[6:12] if command == 30 else now
                self._registers.doubles[:6] = self._chain.inverse(pose_of(values), near)
            case 47:
                self._registers.integers[1] = int(not self._reference.velocities.any())
            case 255:
                self._end_program("stop script")
            case _:
                raise ProgramError(f"the command {command} of the control script is not known to this virtual robot")
        return lambda: True

    def _serve_scripts(self) -> None:
        for port in self._scripts:
            port.poll()
            for connection in port.connections:
                # A program ends with a line `end` that is not indented.
                while found := re.search(rb"\nend[ \t\r]*\n", connection.received):
                    text = connection.received[: found.end()].decode("utf-8", "replace")
                    del connection.received[: found.end()]
                    self._start(text)

    def _start(self, text: str) -> None:
        """Start a program instead of the present one."""
        self._end_program("another one is sent")
        if "def rtde_control" not in text:
            self._robot.note("script_refused", reason="not the control script of ur_rtde", text=text[:200])
        elif self._safety_mode == SafetyMode.NORMAL and self._robot_mode == RobotMode.RUNNING:
            self._program = _Program(heard=self.clock())
            self._registers = _Registers()

    # --- Dashboard and outputs ---

    def _serve_dashboard(self) -> None:
        new, _ = self._dashboard.poll()
        for connection in new:
            connection.send(b"Connected: Universal Robots Dashboard Server\n")
        for connection in self._dashboard.connections:
            for line in connection.lines():
                connection.send(self._dashboard_answer(line, connection).encode() + b"\n")

    def _dashboard_answer(self, line: str, connection: TcpConnection) -> str:
        match line.lower():
            case "robotmode":
                return f"Robotmode: {self._robot_mode.name}"
            case "safetystatus":
                return f"Safetystatus: {self._safety_mode.name}"
            case "safetymode":
                return f"Safetymode: {self._safety_mode.name}"
            case "is in remote control":
                return "true"
            case "polyscopeversion":
                major, minor, fix, build = SOFTWARE
                return f"URSoftware {major}.{minor}.{fix}.{build} (Jan 01 2024)"
            case "get robot model":
                return "UR5"
            case "get serial number":
                return "20205500000"
            case "running":
                return f"Program running: {str(self.is_running).lower()}"
            case "programstate":
                return ("PLAYING" if self.is_running else "STOPPED") + " <unnamed>"
            case "stop":
                self._end_program("dashboard")
                return "Stopped"
            case "unlock protective stop":
                return self._unlock()
            case "close popup" | "close safety popup":
                return f"closing {line[6:].lower()}"
            case "power on":
                if self._safety_mode != SafetyMode.NORMAL:
                    return "Could not power on"
                self._robot_mode = max(self._robot_mode, RobotMode.IDLE)
                return "Powering on"
            case "power off":
                self._switch_off(self._safety_mode)
                return "Powering off"
            case "brake release":
                if self._safety_mode != SafetyMode.NORMAL:
                    return "Could not release brakes"
                self._robot_mode = RobotMode.RUNNING
                return "Brake releasing"
            case "quit":
                connection.send(b"Disconnected\n")
                return ""
            case _:
                return f"could not understand: '{line}'"

    def _unlock(self) -> str:
        if self._safety_mode == SafetyMode.PROTECTIVE_STOP:
            if self.clock() - self._stopped_at < UNLOCK_AFTER:
                return (
                    "Cannot unlock protective stop until 5s after occurrence. "
                    "Always inspect cause of protective stop before unlocking"
                )
            self._safety_mode, self._bad_joint = SafetyMode.NORMAL, None
            self._stand()
        return "Protective stop releasing"

    def _outputs(self) -> dict[str, Output]:
        """Return what RTDE can show, by the names of the vendor's guide."""
        zeros = [0.0] * 6

        def pose_now() -> list[float]:
            return vector_of(self._chain.forward(self._robot.joints)).tolist()

        def target_pose() -> list[float]:
            return vector_of(self._chain.forward(self._reference.joints)).tolist()

        def joint_modes() -> list[int]:
            usual = _JOINT_RUNNING if self._robot_mode == RobotMode.RUNNING else _JOINT_POWER_OFF
            return [_JOINT_FAULT if joint == self._bad_joint else usual for joint in range(6)]

        def status_bits() -> int:
            return int(self._robot_mode > RobotMode.POWER_OFF) | int(self.is_running) << 1

        found = {
            "timestamp": Output("DOUBLE", lambda: self.clock()),
            "target_q": Output("VECTOR6D", lambda: self._reference.joints.tolist()),
            "target_qd": Output("VECTOR6D", lambda: self._reference.velocities.tolist()),
            "actual_q": Output("VECTOR6D", lambda: self._robot.joints.tolist()),
            "actual_qd": Output("VECTOR6D", lambda: self._robot.velocities.tolist()),
            "actual_current": Output(
                "VECTOR6D", lambda: (self._robot.torques / 10.0).tolist()
            ),  # about 10 N·m/A at its joints
            "target_moment": Output("VECTOR6D", lambda: self._robot.torques.tolist()),
            "actual_TCP_pose": Output("VECTOR6D", pose_now),
            "target_TCP_pose": Output("VECTOR6D", target_pose),
            "robot_mode": Output("INT32", lambda: int(self._robot_mode)),
            "safety_mode": Output("INT32", lambda: int(self._safety_mode)),
            "joint_mode": Output("VECTOR6INT32", joint_modes),
            "runtime_state": Output("UINT32", lambda: 2 if self.is_running else 1),
            "robot_status_bits": Output("UINT32", status_bits),
            "safety_status_bits": Output("UINT32", lambda: _SAFETY_BITS[self._safety_mode]),
            "payload": Output("DOUBLE", lambda: self._payload),
        }
        for name in ("target_qdd", "target_current", "joint_control_output", "actual_TCP_speed", "target_TCP_speed",
                     "actual_TCP_force", "joint_temperatures", "actual_joint_voltage", "ft_raw_wrench",
                     "payload_inertia"):  # fmt: skip
            found[name] = Output("VECTOR6D", lambda: zeros)
        for name in ("actual_tool_accelerometer", "payload_cog"):
            found[name] = Output("VECTOR3D", lambda: zeros[:3])
        for name in ("actual_execution_time", "actual_momentum", "standard_analog_input0", "standard_analog_input1",
                     "standard_analog_output0", "standard_analog_output1", "actual_robot_current"):  # fmt: skip
            found[name] = Output("DOUBLE", lambda: 0.0)
        for name in ("speed_scaling", "target_speed_fraction", "speed_scaling_combined"):
            found[name] = Output("DOUBLE", lambda: 1.0)
        for name in ("actual_main_voltage", "actual_robot_voltage"):
            found[name] = Output("DOUBLE", lambda: 48.0)
        for name in ("actual_digital_input_bits", "actual_digital_output_bits"):
            found[name] = Output("UINT64", lambda: 0)
        for index in range(48):
            found[f"output_int_register_{index}"] = Output("INT32", lambda i=index: self._registers.integers[i])
            found[f"output_double_register_{index}"] = Output("DOUBLE", lambda i=index: self._registers.doubles[i])
        return found
