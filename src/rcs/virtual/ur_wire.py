"""The ports of a UR e-series controller: RTDE, dashboard and script ports.

Clients see PolyScope 5.16 in remote control. RTDE (port 30004) sends outputs at up to 500 Hz; the dashboard (29999)
answers lines of text; the script ports (30001 to 30003) accept only the control script of ur_rtde.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Final

from rcs.errors import InvalidSetup
from rcs.virtual.fault import Fault
from rcs.virtual.robotiq_wire import RobotiqWire
from rcs.virtual.rtde_port import VERSION, RtdePort
from rcs.virtual.tcp_port import TcpConnection, TcpPort
from rcs.virtual.ur_controller import RATE, RobotMode, SafetyMode, UrController
from rcs.virtual.ur_outputs import outputs_of
from rcs.virtual.ur_script import ControlScript
from rcs.virtual.virtual_robot import VirtualRobot
from rcs.virtual.wire import Wire, taken

SOFTWARE: Final = (5, 16, 0, 1110000)
"""Version of PolyScope."""


class UrWire(Wire):
    """Implements the interface of an arm and of a Robotiq gripper on its flange."""

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
    """A reflex and an overloaded joint cause a protective stop; `user_stop` is the emergency stop button, `version`
    that of RTDE, and `gripper` a code of the register FLT, with 0 for a power failure."""

    def __init__(self, robot: VirtualRobot, address: str) -> None:
        """Listen on all ports, with the arm powered on, its brakes released, and no program.

        Args:
            robot: The arm; the installation's TCP is that of its gripper.
            address: An IP address of this machine that no other controller uses, since the ports are fixed. With the
                path of a serial line after a comma, the gripper uses Modbus RTU there, else the URCap's socket.

        Raises:
            InvalidSetup: A port is taken.
        """
        self._address, _, serial = address.partition(",")
        self._serial = serial
        self._robot = robot
        self.controller = UrController(robot)
        """The controller behind the ports."""
        self._ticks = 0
        self._thawed = 0.0
        self._ports: list[TcpPort] = []
        self._gripper: RobotiqWire | None = None
        try:
            self._dashboard = self._listen(29999)
            self._scripts = [self._listen(port) for port in (30001, 30002, 30003)]
            self._rtde = RtdePort(self._listen(30004), robot.line, outputs_of(self.controller), SOFTWARE, RATE)
            self._script = ControlScript(self.controller, self._rtde)
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

    def site(self) -> Mapping[str, Mapping[str, Any]]:
        """Return the site entries for the arm (driver `ur`) and its gripper (driver `robotiq`)."""
        found = {"arms": {"driver": "ur", "address": self._address}}
        if self._gripper is not None:
            found["grippers"] = {"driver": "robotiq", "address": self._serial or self._address}
        return found

    def tick(self, robot: VirtualRobot) -> None:
        """Serve the ports and move the arm for 2 ms."""
        self._ticks += 1
        self._rtde.was_set.clear()
        if robot.frozen_until > self._thawed:
            self._thawed = robot.frozen_until
            if self.controller.program is not None and self.controller.program.watchdog:
                self.controller.end_program("watchdog, after the controller had hung")
        if not robot.line.is_cut:
            self._rtde.receive()
            self._serve_dashboard()
            self._serve_scripts()
            if self._gripper is not None:
                self._gripper.serve()
        self._script.run()
        self.controller.lead()
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

    # --- Faults ---

    def tell(self, fault: Fault) -> None:
        """Apply one of `faults`.

        Raises:
            UnknownName: The robot has no such joint.
            InvalidSetup: A value is invalid.
        """
        match fault.name:
            case "protective_stop":
                self.controller.protect("asked for")
            case "reflex":
                self.controller.protect("collision")
            case "user_stop":
                self.controller.switch_off(SafetyMode.ROBOT_EMERGENCY_STOP)
            case "overload":
                self.controller.protect("is overloaded", self._robot.joint_of(fault.value))
            case "undervoltage":
                self.controller.switch_off(SafetyMode.FAULT)
            case "power_off":
                self.controller.switch_off(self.controller.safety_mode)
            case "version":
                self._rtde.version = int(fault.number)
            case _:
                if self._gripper is None or not 0 <= fault.number <= 15:
                    raise InvalidSetup(
                        f"The code is {fault.value!r}; valid is one from 0 to 15, for a robot with a gripper."
                    )
                self._gripper.tell(int(fault.number))

    def clear(self) -> None:
        """Restore what a person restores at the pendant: buttons, power, safety system. A protective stop remains."""
        self._rtde.version = VERSION
        if self._gripper is not None:
            self._gripper.clear()
        self.controller.mend()

    # --- Text ports ---

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
        """Replace the running program by a new one."""
        self.controller.end_program("another one is sent")
        if "def rtde_control" not in text:
            self._robot.note("script_refused", reason="not the control script of ur_rtde", text=text[:200])
        else:
            self.controller.start_program()

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
                return f"Robotmode: {self.controller.robot_mode.name}"
            case "safetystatus":
                return f"Safetystatus: {self.controller.safety_mode.name}"
            case "safetymode":
                return f"Safetymode: {self.controller.safety_mode.name}"
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
                return f"Program running: {str(self.controller.is_running).lower()}"
            case "programstate":
                return ("PLAYING" if self.controller.is_running else "STOPPED") + " <unnamed>"
            case "stop":
                self.controller.end_program("dashboard")
                return "Stopped"
            case "unlock protective stop":
                return self.controller.unlock()
            case "close popup" | "close safety popup":
                return f"closing {line[6:].lower()}"
            case "power on":
                if self.controller.safety_mode != SafetyMode.NORMAL:
                    return "Could not power on"
                self.controller.robot_mode = max(self.controller.robot_mode, RobotMode.IDLE)
                return "Powering on"
            case "power off":
                self.controller.switch_off(self.controller.safety_mode)
                return "Powering off"
            case "brake release":
                if self.controller.safety_mode != SafetyMode.NORMAL:
                    return "Could not release brakes"
                self.controller.robot_mode = RobotMode.RUNNING
                return "Brake releasing"
            case "quit":
                connection.send(b"Disconnected\n")
                return ""
            case _:
                return f"could not understand: '{line}'"
