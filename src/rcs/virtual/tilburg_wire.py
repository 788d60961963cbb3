"""The motors of a Tilburg Hand: sixteen XL330 on a pseudo-terminal, in front of the hand of a virtual robot.

Protocol 2.0 of ROBOTIS: `FF FF FD 00`, the motor's number, the length, an instruction, its parameters, and a CRC-16; an
answer has the motor's error after its instruction.
"""

from __future__ import annotations

import os
import pty
import tty
from collections.abc import Mapping, Sequence
from math import degrees, pi
from typing import Any, ClassVar

import numpy as np

from rcs.errors import InvalidSetup, UnknownName
from rcs.virtual.fault import Fault
from rcs.virtual.virtual_robot import VirtualRobot
from rcs.virtual.wire import Wire

HEADER = b"\xff\xff\xfd\x00"
PING, READ, WRITE, REBOOT, STATUS, SYNC_READ, SYNC_WRITE = 0x01, 0x02, 0x03, 0x08, 0x55, 0x82, 0x83
BROADCAST, MODEL, REGISTERS = 0xFE, 1200, 147
ANSWER_TIME = 5e-5
"""Delay of a motor's answer [s]."""
MODE, TORQUE, ERRORS, GOAL_CURRENT, GOAL, SPEED, POSITION = 11, 64, 70, 102, 116, 128, 132
OVERLOAD, ALERT = 0x20, 0x80
ACCESS_ERROR = 0x07
"""Error of an answer: the register cannot be written now."""
MIDDLE, STEPS = 2048, 4096
MOTORS = (23, 22, 21, 20, 27, 26, 25, 24, 31, 30, 29, 28, 35, 34, 33, 32)
"""Numbers of the motors by joint; default configuration of tilburg-hand 1.1.0."""
REVERSED = ("thumb_mcp", "thumb_abd", "index_mcp", "middle_mcp", "ring_mcp", "index_abd", "middle_abd", "ring_abd")
"""Joints of a right hand whose motors turn the other way; its default calibration, as for the ranges."""


class TilburgWire(Wire):
    """Answers like the motors of a hand. It drives the hand of a robot whose arm has a wire of its own."""

    address = ""
    faults: ClassVar[Mapping[str, str]] = {"overload": "FINGER", "missing": "FINGER"}

    def __init__(self, robot: VirtualRobot, address: str = "") -> None:
        """Create the port.

        Args:
            robot: A robot with a Tilburg Hand.
            address: Must be empty: the system chooses the port.

        Raises:
            InvalidSetup: The robot has another hand, or an address is given.
        """
        if robot.body.hand.name != "tilburg_hand" or address:
            raise InvalidSetup(
                f"These are the motors of a Tilburg Hand at a port of the system's choice, not {address!r}."
            )
        self._robot, self._hand = robot, robot.body.hand
        self._master, self._slave = pty.openpty()  # kept open, so that the port survives its user
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._input = b""
        self._missing: set[int] = set()
        self._overloaded: set[int] = set()
        self._signs = signs = np.array([-1.0 if name in REVERSED else 1.0 for name in self._hand.joints])
        lower, upper = (
            np.array([degrees(one) for one in ends]) for ends in (self._hand.joint_lower, self._hand.joint_upper)
        )
        self._lowest = np.floor(MIDDLE + signs * lower * STEPS / 360.0)
        self._highest = np.floor(MIDDLE + signs * upper * STEPS / 360.0)
        self._motors = {number: bytearray(REGISTERS) for number in MOTORS}
        for number, own in self._motors.items():
            own[0:2], own[7], own[MODE] = MODEL.to_bytes(2, "little"), number, 3
        self._measure()

    def site(self) -> Mapping[str, Mapping[str, Any]]:
        """Return the site entry of the hand."""
        return {"hands": {"driver": "tilburg", "address": os.ttyname(self._slave)}}

    def files(self) -> Sequence[Any]:
        """Return the bus."""
        return (self._master,)

    def receive(self, file: Any) -> None:
        """Answer all complete requests."""
        self._input += os.read(self._master, 4096)
        if self._robot.line.is_cut:
            self._input = b""
        while (start := self._input.find(HEADER)) >= 0:
            self._input = self._input[start:]
            if len(self._input) < 7 or len(self._input) < (end := 7 + int.from_bytes(self._input[5:7], "little")):
                return
            packet, self._input = self._input[:end], self._input[end:]
            if checksum(packet[:-2]) == int.from_bytes(packet[-2:], "little"):
                content = packet[8:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
                self._answer(packet[4], packet[7], content)

    def tick(self, robot: VirtualRobot) -> None:
        """Move powered motors to their goals; the others stay where they are."""
        self._measure()
        ticks = self._ticks()
        goals = [
            int.from_bytes(own[GOAL : GOAL + 4], "little", signed=True) if own[TORQUE] else ticks[i]
            for i, own in enumerate(self._motors.values())
        ]
        share = (np.array(goals) - self._lowest) / (self._highest - self._lowest)
        robot.body.command_hand(np.clip(share, 0.0, 1.0))

    def tell(self, fault: Fault) -> None:
        """Apply a fault: a finger whose motors are overloaded, which switches them off, or do not answer.

        Raises:
            UnknownName: There is no such finger.
        """
        fingers = sorted({name.partition("_")[0] for name in self._hand.joints})
        if fault.value not in fingers:
            raise UnknownName("finger", fault.value, fingers)
        for number, name in zip(MOTORS, self._hand.joints, strict=True):
            if not name.startswith(fault.value):
                continue
            if fault.name == "missing":
                self._missing.add(number)
            else:
                self._overloaded.add(number)
                self._motors[number][ERRORS], self._motors[number][TORQUE] = OVERLOAD, 0

    def clear(self) -> None:
        """Have all motors answer, and remove what overloads them; their errors remain until they are restarted."""
        self._missing.clear()
        self._overloaded.clear()

    def close(self) -> None:
        """Remove the port; closing twice is harmless."""
        if self._master >= 0:
            os.close(self._master)
            os.close(self._slave)
            self._master = -1

    def _ticks(self) -> Any:
        share = np.asarray(self._robot.body.hand_joints, np.float64)
        return np.rint(self._lowest + share * (self._highest - self._lowest)).astype(int)

    def _measure(self) -> None:
        body = self._robot.body
        # The simulated speeds: two positions that differ by a step of the encoder would give 32 units, equal ones 0.
        speeds = np.rint(self._signs * body.world.qvel[body.layout.finger_qvel] * 30.0 / pi / 0.229).astype(int)
        for own, at, speed in zip(self._motors.values(), self._ticks().tolist(), speeds.tolist(), strict=True):
            own[POSITION : POSITION + 4] = int(at).to_bytes(4, "little", signed=True)
            own[SPEED : SPEED + 4] = int(speed).to_bytes(4, "little", signed=True)

    def _answer(self, motor: int, instruction: int, content: bytes) -> None:
        if instruction in (SYNC_READ, SYNC_WRITE):
            first, size = int.from_bytes(content[0:2], "little"), int.from_bytes(content[2:4], "little")
            if instruction == SYNC_READ:
                for one in content[4:]:
                    self._say(one, bytes(self._motors[one][first : first + size]) if one in self._motors else b"")
                return
            for at in range(4, len(content) - size, size + 1):
                self._write(content[at], first, content[at + 1 : at + 1 + size])
            return
        if instruction == PING:
            for one in self._motors if motor == BROADCAST else (motor,):
                self._say(one, MODEL.to_bytes(2, "little") + b"\x2e")
        elif instruction == READ:
            first, size = int.from_bytes(content[0:2], "little"), int.from_bytes(content[2:4], "little")
            self._say(motor, bytes(self._motors.get(motor, b"")[first : first + size]))
        elif instruction == REBOOT and motor in self._motors and motor not in self._missing:
            own = self._motors[motor]
            own[TORQUE], own[ERRORS] = 0, OVERLOAD if motor in self._overloaded else 0
            self._say(motor, b"")
        elif instruction == WRITE:
            is_allowed = self._write(motor, int.from_bytes(content[0:2], "little"), content[2:])
            self._say(motor, b"", 0 if is_allowed else ACCESS_ERROR)

    def _write(self, motor: int, first: int, values: bytes) -> bool:
        """Write registers; return whether that is allowed: the mode is fixed while the motor is on."""
        if motor not in self._motors or motor in self._missing:
            return True
        own = self._motors[motor]
        if (first == MODE and own[TORQUE]) or (first == TORQUE and values[0] and own[ERRORS]):
            return False
        if first == TORQUE and values[0] and not own[TORQUE]:
            own[GOAL : GOAL + 4] = own[POSITION : POSITION + 4]
        own[first : first + len(values)] = values
        return True

    def _say(self, motor: int, values: bytes, error: int = 0) -> None:
        if motor not in self._motors or motor in self._missing:
            return
        error |= ALERT if self._motors[motor][ERRORS] else 0
        stuffed = values.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        data = HEADER + bytes([motor]) + (len(stuffed) + 4).to_bytes(2, "little") + bytes([STATUS, error]) + stuffed
        self._robot.line.send(data + checksum(data).to_bytes(2, "little"), self._write_out, ANSWER_TIME)

    def _write_out(self, packet: bytes) -> None:
        try:
            os.write(self._master, packet)
        except BlockingIOError:  # nobody reads
            return


def _table() -> list[int]:
    found: list[int] = []
    for number in range(256):
        value = number << 8
        for _ in range(8):
            value = (value << 1 ^ (0x8005 if value & 0x8000 else 0)) & 0xFFFF
        found.append(value)
    return found


_TABLE = _table()


def checksum(data: bytes) -> int:
    """Return the CRC-16 of a packet (polynomial 0x8005, from 0)."""
    value = 0
    for byte in data:
        value = (value << 8 ^ _TABLE[(value >> 8 ^ byte) & 0xFF]) & 0xFFFF
    return value
