"""The two interfaces of a Robotiq 2F gripper: the socket of the vendor's URCap, and Modbus RTU on a serial line.

The socket takes lines such as `SET POS 255 GTO 1` and `GET POS`, and answers `ack` or `POS 255`. Modbus RTU follows the
vendor's manual: device 9, three output registers from 0x03E8, three input registers from 0x07D0.
"""

from __future__ import annotations

import contextlib
import os
import struct
import tty
from pathlib import Path
from typing import Final

from rcs.errors import InvalidSetup
from rcs.virtual.tcp_port import TcpPort
from rcs.virtual.virtual_robot import VirtualRobot

OPEN, CLOSED = 3, 230
"""End positions of the fingers of a 2F-85 [1], which does not use the whole range from 0 to 255."""
DEVICE: Final = 9
"""Modbus address of the gripper."""
FIRST_OUTPUT, FIRST_INPUT = 0x03E8, 0x07D0
SLOWEST, FASTEST = 0.020, 0.150
"""Speeds of the width at 0 and 255 [m/s]; vendor's data sheet."""
WEAKEST, STRONGEST = 20.0, 235.0
"""Forces at 0 and 255 [N]; vendor's data sheet."""

_MOVING, _STOPPED_OPENING, _STOPPED_CLOSING, _THERE = 0, 1, 2, 3
_RESET, _ACTIVATING, _ACTIVE = 0, 1, 3
_NOT_ACTIVATED = 7
_FIRST_MAJOR = 0x0A
_SETTABLE = ("ACT", "GTO", "ATR", "POS", "SPE", "FOR")


class RobotiqWire:
    """Implements the interface of a robot's gripper; call `serve` every tick. It starts activated, as by the URCap."""

    def __init__(self, robot: VirtualRobot, port: TcpPort | None = None, serial: Path | None = None) -> None:
        """Serve a socket or a serial line.

        Args:
            robot: Robot that carries the gripper.
            port: Port 63352 of the controller; None for a serial line.
            serial: Path of the serial line to create; it must not exist.

        Raises:
            InvalidSetup: The path exists.
        """
        self._robot = robot
        self._port = port
        self._link = serial
        self._line = -1
        self._received = b""
        if serial is not None:
            self._line, other = os.openpty()
            tty.setraw(other)
            os.set_blocking(self._line, False)
            self._other = other  # kept open, so that the line survives a client that disconnects
            try:
                serial.symlink_to(os.ttyname(other))
            except OSError as err:
                self.close()
                raise InvalidSetup(f"The serial line {serial} cannot be made: {err}.") from err
        self._set = {"ACT": 1, "GTO": 0, "ATR": 0, "POS": 0, "SPE": 255, "FOR": 0}
        self._status, self._fault = _ACTIVE, 0
        self._activation: list[float] = []  # remaining widths to move to [m]
        self._from = 0.0

    def tell(self, code: int) -> None:
        """Report a fault code of the manual; 0 resets the activation, as a power failure does."""
        if code == 0:
            self._set |= {"ACT": 0, "GTO": 0}
            self._status, self._fault, self._activation = _RESET, 0, []
        else:
            self._fault = code
            if code >= _FIRST_MAJOR:
                self._set["GTO"], self._status = 0, _RESET
        self._halt()

    def clear(self) -> None:
        """Remove the causes of faults; latched faults remain until the gripper is activated again."""
        if self._fault < _FIRST_MAJOR:
            self._fault = 0

    def serve(self) -> None:
        """Answer received requests and continue the motion or activation in progress."""
        if self._port is not None:
            self._port.poll()
            for connection in self._port.connections:
                for line in connection.lines():
                    connection.send(self._answer(line))
        elif self._line >= 0:
            self._serve_modbus()
        self._step()

    def close(self) -> None:
        """Remove the serial line; closing twice is harmless."""
        if self._line < 0:
            return
        os.close(self._line)
        os.close(self._other)
        self._line = -1
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()

    # --- Fingers ---

    @property
    def _position(self) -> int:
        assert self._robot.gripper is not None
        return round(CLOSED + (OPEN - CLOSED) * self._robot.width / self._robot.gripper.max_width)

    @property
    def _object(self) -> int:
        if self._status != _ACTIVE or not self._robot.is_grip_still:
            return _MOVING
        wanted = min(max(self._set["POS"], OPEN), CLOSED)
        if not self._set["GTO"] or abs(self._position - wanted) <= 4:
            return _THERE
        return _STOPPED_CLOSING if self._position < wanted else _STOPPED_OPENING

    def _change(self, values: dict[str, int]) -> None:
        before = dict(self._set)
        self._set |= values
        gripper = self._robot.gripper
        assert gripper is not None
        if not self._set["ACT"]:
            self.tell(0)
        elif not before["ACT"]:
            self._status, self._fault = _ACTIVATING, 0
            self._activation = [0.0, gripper.max_width]
            self._robot.move(0.0, FASTEST / 2)
        elif self._status != _ACTIVE or self._fault >= _FIRST_MAJOR:
            self._fault = self._fault or _NOT_ACTIVATED
        elif not self._set["GTO"]:
            self._halt()
        elif self._set != before:
            share = (CLOSED - self._set["POS"]) / (CLOSED - OPEN)
            speed = SLOWEST + (FASTEST - SLOWEST) * self._set["SPE"] / 255
            force = WEAKEST + (STRONGEST - WEAKEST) * self._set["FOR"] / 255
            self._robot.grasp(min(max(share, 0.0), 1.0) * gripper.max_width, speed, force)

    def _halt(self) -> None:
        """Stop the fingers; they keep holding an object, because the drive is self-locking."""
        if not self._robot.is_grip_still:
            self._robot.move(self._robot.width)

    def _step(self) -> None:
        if self._activation and self._robot.is_grip_still:
            self._activation.pop(0)
            if self._activation:
                self._robot.move(self._activation[0], FASTEST / 2)
            else:
                self._status = _ACTIVE

    # --- Socket ---

    def _answer(self, line: str) -> bytes:
        verb, *words = line.split() or [""]
        try:
            if verb == "GET" and len(words) == 1:
                return f"{words[0]} {self._values()[words[0]]}\n".encode()
            if verb == "SET" and words and len(words) % 2 == 0:
                values = {name: int(value) for name, value in zip(words[::2], words[1::2], strict=True)}
                if all(name in _SETTABLE and 0 <= value <= 255 for name, value in values.items()):
                    self._change(values)
                    return b"ack"
        except (KeyError, ValueError):
            pass
        return b"?\n"

    def _values(self) -> dict[str, int]:
        return {
            **self._set,
            "POS": self._position,
            "PRE": self._set["POS"],
            "STA": self._status,
            "OBJ": self._object,
            "FLT": self._fault,
        }

    # --- Modbus RTU ---

    def answer_frame(self, frame: bytes) -> bytes:
        """Return the answer to a frame, both without checksum; b"" if it is for another device."""
        if len(frame) < 2 or frame[0] != DEVICE:
            return b""
        return bytes([DEVICE]) + self._modbus(frame[1], frame[2:])

    def _serve_modbus(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._received += os.read(self._line, 4096)
        while (size := _size_of(self._received)) and len(self._received) >= size:
            frame, self._received = self._received[:size], self._received[size:]
            frame = self._robot.line.receive(frame) or b""
            answer = self.answer_frame(frame[:-2]) if crc(frame[:-2]) == frame[-2:] else b""
            if not answer:
                self._received = b""  # a damaged frame: wait for the next one, as after a pause on the line
                return
            self._robot.line.send(answer + crc(answer), self._write)

    def _write(self, data: bytes) -> None:
        with contextlib.suppress(BlockingIOError):  # no client reads
            os.write(self._line, data)

    def _modbus(self, function: int, body: bytes) -> bytes:
        """Return the answer or exception to a request, without address and checksum."""
        if function in (3, 4):
            first, count = struct.unpack(">HH", body)
            registers = self._inputs()
            begin = first - FIRST_INPUT
            if begin < 0 or begin + count > len(registers):
                return bytes([function | 0x80, 2])
            return bytes([function, 2 * count]) + struct.pack(f">{count}H", *registers[begin : begin + count])
        if function == 16:
            first, count, size = struct.unpack_from(">HHB", body)
            if first != FIRST_OUTPUT or count != 3 or size != 6:
                return bytes([function | 0x80, 2])
            request, _, _, position, speed, force = body[5:]
            flags = {"ACT": request & 1, "GTO": request >> 3 & 1, "ATR": request >> 4 & 1}
            self._change({**flags, "POS": position, "SPE": speed, "FOR": force})
            return bytes([function]) + body[:4]
        return bytes([function | 0x80, 1])

    def _inputs(self) -> list[int]:
        values = self._values()
        status = values["ACT"] | values["GTO"] << 3 | values["STA"] << 4 | values["OBJ"] << 6
        return [status << 8, values["FLT"] << 8 | values["PRE"], values["POS"] << 8]


def crc(frame: bytes) -> bytes:
    """Return the checksum of a frame of Modbus RTU."""
    value = 0xFFFF
    for byte in frame:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return struct.pack("<H", value)


def _size_of(data: bytes) -> int:
    """Return the length of the request that starts with these bytes; 0 if they are too few."""
    if len(data) < 7:
        return 0
    return 9 + data[6] if data[1] == 16 else 8
