"""A GELLO: a small copy of an arm with Dynamixel servos, built for the robot that follows it.

Positions are read, and motors are off or gentle, by protocol 2.0 of ROBOTIS
(emanual.robotis.com/docs/en/dxl/protocol2) and the registers of the X series. The vendor's library waits for answers
without letting other threads run; a control loop beside it would be late.
"""

from __future__ import annotations

import select
import termios
import time
from collections.abc import Sequence
from math import tau
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.errors import DeviceFault, InvalidSetup
from rcs.extras import package_of
from rcs.teleop.leader import Leader, LeaderCalibration

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
READ, WRITE, STATUS, SYNC_READ, SYNC_WRITE = 0x02, 0x03, 0x55, 0x82, 0x83
MODE, TORQUE, WATCHDOG, GOAL_CURRENT, GOAL, POSITION, POSITION_SIZE = 11, 64, 98, 102, 116, 132, 4
"""Registers of the X series."""
BY_CURRENT = 5
"""Mode in which a bounded current turns a servo to a position, over many turns; not all servos have it."""
CURRENT = 150
"""Largest current of a motor, in the servo's units: 0.15 A of an XL330, 0.4 A of an XM430, about a tenth of what they
can."""
PATIENCE = 10
"""Time without any packet after which a servo drops its current by itself, in its units of 20 ms."""
OFF_AGAIN = 5
"""Packets that switch motors off: servos do not acknowledge them."""
STEPS = 4096
"""Positions per turn."""
TIMEOUT = 0.09
"""Time without an answer after which servos count as lost [s]; adapters keep input for up to 16 ms."""
LONGEST = 64
"""Most bytes of an answer after its header."""


def checksum(data: bytes) -> int:
    """Return the CRC-16 of a packet (polynomial 0x8005, from 0)."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x8005) & 0xFFFF if crc & 0x8000 else crc << 1
    return crc


def packet(servo: int, instruction: int, values: bytes = b"") -> bytes:
    """Return a packet for a servo."""
    stuffed = values.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    data = HEADER + bytes([servo]) + (len(stuffed) + 3).to_bytes(2, "little") + bytes([instruction]) + stuffed
    return data + checksum(data).to_bytes(2, "little")


class Answers:
    """Decodes the answers of servos, in pieces of any size."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self._rest = b""
        self.damaged = 0
        """Number of packets that could not be used."""

    def feed(self, data: bytes) -> list[tuple[int, bytes]]:
        """Return servos with their values, of the packets that are complete with these bytes."""
        self._rest += data
        found: list[tuple[int, bytes]] = []
        while (start := self._rest.find(HEADER)) >= 0:
            self._rest = self._rest[start:]
            length = int.from_bytes(self._rest[5:7], "little")
            if len(self._rest) >= 7 and not 4 <= length <= LONGEST:
                self._skip()
            elif len(self._rest) < 7 or len(self._rest) < 7 + length:
                return found
            elif checksum(self._rest[: 5 + length]) != int.from_bytes(self._rest[5 + length : 7 + length], "little"):
                self._skip()
            else:
                body, self._rest = self._rest[: 5 + length], self._rest[7 + length :]
                if body[7] == STATUS:  # otherwise it is our own question, on a line that echoes
                    found.append((body[4], body[9:].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")))
        self._rest = self._rest[-3:]
        return found

    def _skip(self) -> None:
        self.damaged += 1
        self._rest = self._rest[len(HEADER) :]


class DynamixelBus:
    """Servos of a leader; the last one is the gripper's."""

    def __init__(self, calibration: LeaderCalibration) -> None:
        """Connect and switch the motors off.

        Args:
            calibration: Its address, servos and speed of the line are used.

        Raises:
            DeviceFault: There is no port, it is in use or may not be used, or a servo does not answer.
            MissingDependency: pyserial is not installed.
        """
        serial = package_of("leader", "serial", "Dynamixel servos need")
        self.address, self._servos = calibration.address, calibration.servos
        self.failures = 0
        """Number of questions that had to be repeated."""
        self._is_prepared = self._is_on = False
        self._off_again = 0
        try:
            self._port: Any = serial.Serial(
                self.address, calibration.baud, timeout=0, write_timeout=1.0, exclusive=True
            )
        except (OSError, ValueError) as err:  # pyserial's own are of OSError
            raise DeviceFault(f"There is no use of the serial port {self.address}: {_remedy(err)}") from err
        try:
            for servo in self._servos:
                self._ask(packet(servo, WRITE, TORQUE.to_bytes(2, "little") + b"\0"), (servo,), 0)
        except BaseException:
            self.close()
            raise

    def angles(self) -> NDArray[np.float64]:
        """Return the servos' angles [rad]."""
        where = POSITION.to_bytes(2, "little") + POSITION_SIZE.to_bytes(2, "little")
        found = self._ask(packet(BROADCAST, SYNC_READ, where + bytes(self._servos)), self._servos, POSITION_SIZE)
        positions = [int.from_bytes(found[servo], "little", signed=True) for servo in self._servos]
        return np.array(positions) * (tau / STEPS)

    def drive(self, angles: NDArray[np.float64] | None) -> None:
        """Have motors turn the joints to angles [rad] with at most `CURRENT`; None switches them off.

        Raises:
            DeviceFault: A servo does not answer, or has no mode in which its current is bounded.
        """
        if angles is None:
            if self._is_on:
                self._is_on, self._off_again = False, OFF_AGAIN
            if self._off_again > 0:
                self._off_again -= 1
                self._write_all(TORQUE, bytes(1))
            return
        joints = self._servos[:-1]
        goals = {servo: round(angle * STEPS / tau) for servo, angle in zip(joints, angles, strict=True)}
        if not self._is_prepared:
            self._prepare(joints)
        if not self._is_on:
            for register, values in ((WATCHDOG, bytes(1)), (GOAL_CURRENT, CURRENT.to_bytes(2, "little"))):
                self._write_all(register, values)  # a servo that has dropped its current takes no other until then
            self._write_all(WATCHDOG, bytes([PATIENCE]))
        self._write_all(GOAL, {servo: goal.to_bytes(4, "little", signed=True) for servo, goal in goals.items()})
        if not self._is_on:
            self._is_on = True
            self._write_all(TORQUE, b"\1")

    def close(self) -> None:
        """Switch the motors off and close the port."""
        try:
            for _ in range(OFF_AGAIN if self._is_on else 0):
                self._write_all(TORQUE, bytes(1))
            self._is_on = False
        except DeviceFault:
            return  # the servos drop their current by themselves
        finally:
            self._port.close()

    def _prepare(self, joints: Sequence[int]) -> None:
        where = MODE.to_bytes(2, "little")
        for servo in joints:
            found = self._ask(packet(servo, READ, where + b"\1\0"), (servo,), 1)
            if found[servo][0] != BY_CURRENT:
                self._ask(packet(servo, WRITE, where + bytes([BY_CURRENT])), (servo,), 0)
                found = self._ask(packet(servo, READ, where + b"\1\0"), (servo,), 1)
            if found[servo][0] != BY_CURRENT:
                raise DeviceFault(
                    f"The servo {servo} at {self.address} stays in the mode {found[servo][0]}, not {BY_CURRENT}, so "
                    "its current cannot be bounded; leave out the torque."
                )
        self._is_prepared = True

    def _write_all(self, register: int, values: bytes | dict[int, bytes]) -> None:
        """Write a register of all joints; servos do not answer that."""
        each = values if isinstance(values, dict) else dict.fromkeys(self._servos[:-1], values)
        size = len(next(iter(each.values())))
        words = b"".join(bytes([servo]) + own for servo, own in each.items())
        head = register.to_bytes(2, "little") + size.to_bytes(2, "little")
        try:
            self._port.write(packet(BROADCAST, SYNC_WRITE, head + words))
        except (OSError, termios.error) as err:
            raise self._gone(err) from err

    def _ask(self, question: bytes, servos: Sequence[int], size: int) -> dict[int, bytes]:
        """Return the values of each servo, of a size; ask again what is not answered."""
        begin = time.monotonic()
        found: dict[int, bytes] = {}
        try:
            while time.monotonic() < begin + TIMEOUT:
                self._port.reset_input_buffer()  # an answer to an earlier question would be taken for this one's
                self._port.write(question)
                answers, end = Answers(), time.monotonic() + TIMEOUT / 2
                while (rest := end - time.monotonic()) > 0:
                    select.select([self._port.fileno()], [], [], rest)
                    found.update((servo, values) for servo, values in answers.feed(self._port.read(256))
                                 if servo in servos and len(values) == size)  # fmt: skip
                    if len(found) == len(servos):
                        return found
                self.failures += 1
        except (OSError, termios.error) as err:  # the latter is no OSError
            raise self._gone(err) from err
        missing = ", ".join(str(servo) for servo in servos if servo not in found)
        raise DeviceFault(
            f"The servos {missing} at {self.address} do not answer; check power supply, cables, numbers and baud rate."
        )

    def _gone(self, err: Exception) -> DeviceFault:
        return DeviceFault(f"The servos at {self.address} have disappeared: {err}. Check the USB cable.")


def gello(address: str | None = None, *, torque: bool = False) -> Leader:
    """Return the leader with the calibration in a file.

    Args:
        address: Path of a file that `rcs calibrate leader` has written; it has the serial port.
        torque: Have motors lead the arm gently after the robot while the person does not lead; see `Leader`.

    Raises:
        InvalidSetup: There is no such file.
    """
    if not address or not address.endswith(".json"):
        raise InvalidSetup(
            f"A GELLO needs the file of its calibration, such as gello:gello.json, not {address!r}; "
            "`rcs calibrate leader` writes it."
        )
    return Leader(LeaderCalibration.read(address), DynamixelBus, torque=torque)


def _remedy(err: Exception) -> str:
    if getattr(err, "errno", None) == 13:
        return f"{err}. Join the port's group and log in again: sudo usermod -aG dialout $USER."
    if getattr(err, "errno", None) == 11:
        return f"another program uses it ({err}); end that first."
    return f"{err}. Check the cable and the port: ls -l /dev/serial/by-id"
