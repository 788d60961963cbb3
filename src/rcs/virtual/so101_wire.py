"""The servo bus of an SO101: six Feetech STS3215 on a pseudo-terminal, in front of a virtual robot.

The bus has one wire for both directions, so servos answer one after the other. A request consists of `FF FF`, the
servo's number, the number of bytes that follow, an instruction, its parameters, and the inverted sum of all bytes after
`FF FF`; an answer has the servo's errors instead of the instruction.
"""

from __future__ import annotations

import os
import pty
import tty
from collections.abc import Mapping, Sequence
from math import tau
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from rcs.errors import InvalidSetup
from rcs.virtual.fault import Fault
from rcs.virtual.virtual_robot import VirtualRobot
from rcs.virtual.wire import Wire, taken

STEPS = 4096
"""Encoder positions per turn."""
MODEL = 777
"""Model number of the STS3215."""
BYTE_TIME = 1e-5
"""Duration of a byte on the bus at 1 Mbit/s [s]."""
ANSWER_TIME = 5e-5
"""Delay of a servo's answer [s]."""
BROADCAST = 0xFE
PING, READ, WRITE, SYNC_READ, SYNC_WRITE = 1, 2, 3, 0x82, 0x83
VOLTAGE, OVERLOAD = 1, 32
"""Error bits in an answer."""
# Addresses of registers.
MODEL_NUMBER, ID, STATUS_LEVEL, LOWEST, HIGHEST, LEAST_VOLTAGE, MOST_TORQUE = 3, 5, 8, 9, 11, 15, 16
OFFSET, PROTECTIVE_TORQUE, PROTECTION_TIME, OVERLOAD_TORQUE = 31, 34, 35, 36
TORQUE_ON, GOAL, TORQUE_LIMIT, POSITION, SPEED, LOAD, VOLTS, DEGREES = 40, 42, 48, 56, 58, 60, 62, 63
ERRORS, MOVING, CURRENT, REGISTERS = 65, 66, 69, 87
READ_ONLY = frozenset({*range(5), *range(POSITION, 71)})
MIDDLES = (2051, 2035, 2072, 2007)
"""Positions in the middle of the ranges, where a person put the joints by eye during calibration."""
OFFSETS = (-312, 845, -1203, 77, 1406, -651)
"""Encoder positions that count as 0."""


class So101Wire(Wire):
    """Answers like servos 1 to 5 of an arm and 6 of its gripper; each of several arms has a pseudo-terminal."""

    rate = 500
    address = ""
    faults: ClassVar[Mapping[str, str]] = {"overload": "JOINT", "undervoltage": "", "code": "N", "version": "N"}

    def __init__(self, robot: VirtualRobot, address: str) -> None:
        """Create the port.

        Args:
            robot: An SO101 with its gripper.
            address: Path of a link to the port; "" for none.

        Raises:
            InvalidSetup: The path exists, or the robot is not an SO101 with a gripper.
        """
        if robot.about.dof != 5 or robot.gripper is None:
            raise InvalidSetup(f"The bus of an SO101 is for an arm of five joints with a gripper, not {robot.name!r}.")
        self._robot = robot
        self._last_opening = float(robot.body.opening[0])
        self._link = Path(address) if address else None
        self._master, self._slave = pty.openpty()  # kept open, so that the port survives its user
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        if self._link is not None:
            try:
                if self._link.is_symlink() and not self._link.exists():
                    self._link.unlink()  # left behind by a process that was killed
                self._link.symlink_to(os.ttyname(self._slave))
            except OSError as err:
                self._link = None
                self.close()
                raise taken("The servo bus", address, err) from err
        self._input = b""
        self._is_low, self._code = False, 0
        self._is_on_stand = True  # until first switched on; the arm would fall from home
        self._names = (*robot.about.joints, "gripper")
        self._overloaded_for = np.zeros(6)
        self._is_overloaded = np.zeros(6, np.bool_)
        self._servos = [bytearray(REGISTERS) for _ in range(6)]
        for servo in range(6):
            self._calibrate(servo)
        self._measure(robot)

    @staticmethod
    def next_address(address: str) -> str:
        """Return the path of the next arm's port."""
        return f"{address}-2" if address else ""

    def site(self) -> Mapping[str, Mapping[str, Any]]:
        """Return the site entries, with the path of the bus and the calibration in LeRobot's format."""
        address = os.ttyname(self._slave) if self._link is None else str(self._link)
        entry = {"driver": "so101", "address": address, "options": {"calibration": self.calibration()}}
        return {"arms": entry, "grippers": entry}

    def calibration(self) -> dict[str, dict[str, int]]:
        """Return the calibration by motor."""
        found: dict[str, dict[str, int]] = {}
        for number, name in enumerate(self._names):
            lowest, highest = self._number(number, LOWEST), self._number(number, HIGHEST)
            offset = _signed(self._number(number, OFFSET), 11)
            values = {"homing_offset": offset, "range_min": lowest, "range_max": highest}
            found[name] = {"id": number + 1, "drive_mode": 0, **values}
        return found

    def files(self) -> Sequence[Any]:
        """Return the bus."""
        return (self._master,)

    def receive(self, file: Any) -> None:
        """Answer all complete requests."""
        self._input += os.read(self._master, 4096)
        if self._robot.line.is_cut:
            self._input = b""
        while (start := self._input.find(b"\xff\xff")) >= 0:
            self._input = self._input[start:]
            if len(self._input) < 4 or len(self._input) < (end := 4 + self._input[3]):
                return
            packet, self._input = self._input[:end], self._input[end:]
            if len(packet) >= 6 and packet[-1] == _checksum(packet[2:-1]):
                self._answer(packet[2], packet[4], packet[5:-1])

    def tick(self, robot: VirtualRobot) -> None:
        """Move powered servos to their goals within their torque limits, and apply their protection."""
        self._measure(robot)
        self._protect(robot.period)
        shares = np.array([self._share(number) for number in range(6)])
        is_on = np.array([bool(own[TORQUE_ON]) for own in self._servos])
        for number in range(6):  # a servo without power would be held where it was moved to
            if not is_on[number]:
                self._set(number, GOAL, self._number(number, POSITION))
        goals = [self._angle(number, self._number(number, GOAL)) for number in range(5)]
        robot.limit(np.ones(5) if self._is_on_stand else shares[:5])
        robot.lead(robot.commanded if self._is_on_stand else np.where(is_on[:5], goals, robot.joints))
        gripper = robot.body.gripper
        # The gripper's model already has half of the servo's torque.
        force = min(2.0 * shares[5], 1.0) * gripper.grasp_force
        robot.grasp(self._opening(self._number(5, GOAL)) * gripper.max_width, None, force)

    def tell(self, fault: Fault) -> None:
        """Apply a fault: an overloaded servo, or for all servos a low voltage, errors, or another model number.

        Raises:
            UnknownName: The robot has no such joint.
            InvalidSetup: A value is invalid.
        """
        if fault.name == "overload":
            number = 5 if fault.value == "gripper" else self._robot.joint_of(fault.value)
            self._is_overloaded[number] = True
        elif fault.name == "undervoltage":
            self._is_low = True
        elif fault.name == "code":
            self._code = fault.whole(0x7F)
        else:
            model = fault.whole(0xFFFF)
            for number in range(6):
                self._set(number, MODEL_NUMBER, model)

    def clear(self) -> None:
        """Restore the servos' voltage and model number; an overload lasts until the torque is switched off."""
        self._is_low, self._code = False, 0
        for number in range(6):
            self._set(number, MODEL_NUMBER, MODEL)

    def close(self) -> None:
        """Remove the port; closing twice is harmless."""
        if self._master < 0:
            return
        os.close(self._master)
        os.close(self._slave)
        self._master = -1
        if self._link is not None:
            self._link.unlink(missing_ok=True)

    # --- Registers ---

    def _calibrate(self, servo: int) -> None:
        """Write the registers of a calibrated servo without motor power."""
        own, span = self._servos[servo], STEPS / tau
        own[0], own[1], own[ID], own[STATUS_LEVEL], own[LEAST_VOLTAGE] = 3, 10, servo + 1, 1, 40
        own[PROTECTIVE_TORQUE], own[PROTECTION_TIME], own[OVERLOAD_TORQUE] = 20, 200, 80
        own[VOLTS], own[DEGREES] = 121, 30
        if servo == 5:
            lowest, highest = 2047, 2047 + round(span * 1.92)
        elif self._names[servo] == "wrist_roll":  # it turns without limits
            lowest, highest = 0, STEPS - 1
        else:
            lowest = round(MIDDLES[servo] + span * self._robot.about.joint_lower[servo])
            highest = round(MIDDLES[servo] + span * self._robot.about.joint_upper[servo])
        values = {MODEL_NUMBER: MODEL, LOWEST: lowest, HIGHEST: highest, MOST_TORQUE: 1000, TORQUE_LIMIT: 1000}
        for register, value in {**values, OFFSET: _magnitude(OFFSETS[servo], 11)}.items():
            self._set(servo, register, value)

    def _number(self, servo: int, register: int) -> int:
        return int.from_bytes(self._servos[servo][register : register + 2], "little")

    def _set(self, servo: int, register: int, value: int) -> None:
        self._servos[servo][register : register + 2] = value.to_bytes(2, "little")

    def _angle(self, servo: int, steps: int) -> float:
        return (steps - self._middle(servo)) * tau / STEPS

    def _middle(self, servo: int) -> float:
        return 0.5 * (self._number(servo, LOWEST) + self._number(servo, HIGHEST))

    def _opening(self, steps: int) -> float:
        lowest, highest = self._number(5, LOWEST), self._number(5, HIGHEST)
        return (steps - lowest) / max(highest - lowest, 1)

    # --- Physics ---

    def _measure(self, robot: VirtualRobot) -> None:
        lowest, highest = self._number(5, LOWEST), self._number(5, HIGHEST)
        opening = float(robot.body.opening[0])
        grip = robot.grip_force / (2.0 * robot.body.gripper.grasp_force)
        loads = [*(robot.torques / np.array(robot.about.effort_limit)), grip]
        for servo in range(6):
            if servo < 5:
                steps = self._middle(servo) + robot.joints[servo] * STEPS / tau
                speed = robot.velocities[servo] * STEPS / tau
            else:
                steps = lowest + opening * (highest - lowest)
                speed = (opening - self._last_opening) * (highest - lowest) / robot.period
                self._last_opening = opening
            self._set(servo, POSITION, _magnitude(round(steps), 15))
            self._set(servo, SPEED, _magnitude(round(speed), 15))
            load = round(1000 * float(np.clip(loads[servo], -1.0, 1.0)))
            self._set(servo, LOAD, _magnitude(load, 10))
            self._set(servo, CURRENT, abs(load) * 2700 // 6500)  # 2.7 A at stall, in steps of 6.5 mA
            own = self._servos[servo]
            own[MOVING] = int(abs(speed) > 50)
            own[VOLTS] = 36 if self._is_low else 121
            errors = VOLTAGE * (own[VOLTS] < own[LEAST_VOLTAGE]) | OVERLOAD * bool(self._is_overloaded[servo])
            own[ERRORS] = errors | self._code

    def _protect(self, passed: float) -> None:
        for servo, own in enumerate(self._servos):
            load = abs(_signed(self._number(servo, LOAD), 10)) / 10.0
            is_over = load > own[OVERLOAD_TORQUE] and own[TORQUE_ON]
            self._overloaded_for[servo] = self._overloaded_for[servo] + passed if is_over else 0.0
            self._is_overloaded[servo] |= bool(self._overloaded_for[servo] > 0.01 * own[PROTECTION_TIME])

    def _share(self, servo: int) -> float:
        """Return the fraction of its torque that a servo may exert."""
        own = self._servos[servo]
        if not own[TORQUE_ON]:
            return 0.0
        most = min(self._number(servo, MOST_TORQUE), self._number(servo, TORQUE_LIMIT)) / 1000
        return min(most, own[PROTECTIVE_TORQUE] / 100) if self._is_overloaded[servo] else most

    # --- Packets ---

    def _answer(self, servo: int, instruction: int, values: bytes) -> None:
        servos = range(6) if servo == BROADCAST else [servo - 1] if 1 <= servo <= 6 else []
        is_answered = servo != BROADCAST
        used = 6 + len(values)  # bytes on the bus
        if instruction == PING and not values:
            for one in servos:
                used = self._reply(one, b"", used)
        elif instruction == READ and len(values) == 2 and is_answered:
            for one in servos:
                used = self._reply(one, self._block(one, *values), used)
        elif instruction == SYNC_READ and len(values) > 2:
            for one in values[2:]:
                if 1 <= one <= 6:
                    used = self._reply(one - 1, self._block(one - 1, values[0], values[1]), used)
        elif instruction == WRITE and values:
            for one in servos:
                self._write(one, values[0], values[1:])
                if is_answered and self._servos[one][STATUS_LEVEL]:
                    used = self._reply(one, b"", used)
        elif instruction == SYNC_WRITE and len(values) > 2:
            first, count = values[0], values[1]
            for at in range(2, len(values) - count, count + 1):
                if 1 <= values[at] <= 6:
                    self._write(values[at] - 1, first, values[at + 1 : at + 1 + count])
            if first == GOAL and set(values[2 :: count + 1]) >= set(range(1, 6)):
                self._robot.log_point(joints=[self._angle(number, self._number(number, GOAL)) for number in range(5)])

    def _block(self, servo: int, first: int, count: int) -> bytes:
        return bytes(self._servos[servo][first : first + count]).ljust(count, b"\0")

    def _write(self, servo: int, first: int, values: bytes) -> None:
        own = self._servos[servo]
        before = own[TORQUE_ON]
        for register, value in enumerate(values, first):
            if register < REGISTERS and register not in READ_ONLY:
                own[register] = value
        if first <= GOAL < first + len(values):
            lowest, highest = self._number(servo, LOWEST), self._number(servo, HIGHEST)
            self._set(servo, GOAL, min(max(self._number(servo, GOAL), lowest), highest))
        self._is_on_stand &= servo == 5 or not own[TORQUE_ON]
        if before != own[TORQUE_ON]:
            self._robot.note("torque", servo=self._names[servo], on=bool(own[TORQUE_ON]))
        if first <= TORQUE_ON < first + len(values) and not own[TORQUE_ON]:
            self._is_overloaded[servo], self._overloaded_for[servo] = False, 0.0
            own[ERRORS] &= ~OVERLOAD

    def _reply(self, servo: int, values: bytes, used: int) -> int:
        """Send an answer after `used` bytes on the bus; return the number of bytes including it."""
        body = bytes([servo + 1, len(values) + 2, self._servos[servo][ERRORS], *values])
        packet = b"\xff\xff" + body + bytes([_checksum(body)])
        used += len(packet)
        self._robot.line.send(packet, self._send, after=BYTE_TIME * used + ANSWER_TIME)
        return used

    def _send(self, packet: bytes) -> None:
        try:
            os.write(self._master, packet)
        except BlockingIOError:  # no client reads; a real bus does not wait either
            return


def _checksum(values: bytes) -> int:
    return ~sum(values) & 0xFF


def _magnitude(value: int, bit: int) -> int:
    """Return a number as servos store it: its magnitude and a sign bit."""
    return min(abs(value), (1 << bit) - 1) | ((value < 0) << bit)


def _signed(value: int, bit: int) -> int:
    """Return a number from the magnitude and sign bit that a servo stores."""
    amount = value & ((1 << bit) - 1)
    return -amount if value >> bit & 1 else amount
