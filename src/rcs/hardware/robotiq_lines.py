"""Transports to a Robotiq gripper: the URCap's socket on a UR controller, and Modbus RTU on a serial line."""

from __future__ import annotations

import os
import socket
import termios
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

from rcs.errors import DeviceFault
from rcs.extras import package_of
from rcs.hardware.serial_port import claim, port_at

PORT: Final = 63352
"""Port of the URCap's socket."""
MODBUS_DEVICE: Final = 9
FIRST_OUTPUT: Final = 0x03E8
FIRST_INPUT: Final = 0x07D0
BAUD_RATE: Final = 115200
CONNECT_TIME: Final = 0.4
"""Timeout for connecting [s]."""
ANSWER_TIME: Final = 0.1
"""Timeout for an answer of the URCap [s]; usually it takes 2 to 20 ms."""


@dataclass(frozen=True, kw_only=True)
class RobotiqStatus:
    """Status of the gripper, with the register names of its manual."""

    activation: int
    """STA, activation: 0 reset, 1 in progress, 3 activated."""
    goes: int
    """GTO: 1 if it moves to the requested position, 0 if it is stopped."""
    object: int
    """OBJ: 0 moving, 1 and 2 stopped by an object while opening and closing, 3 at the requested position."""
    fault: int
    """FLT: fault code."""
    request: int
    """PRE: requested position."""
    position: int
    """POS: position, 0 open … 255 closed."""
    time: float
    """Time of the reading on the host's monotonic clock [s]."""


class Transport(Protocol):
    """Access to the gripper's registers, one call at a time. Calls raise `DeviceFault`."""

    def read(self) -> RobotiqStatus:
        """Read all input registers."""
        ...

    def write(self, *, activate: bool, go: bool, position: int, speed: int, force: int) -> None:
        """Write all output registers."""
        ...

    def close(self) -> None:
        """Disconnect."""
        ...


class UrcapSocket:
    """The socket of Robotiq's URCap."""

    _NAMES = ("STA", "GTO", "OBJ", "FLT", "PRE", "POS")

    def __init__(self, address: str) -> None:
        """Connect.

        Raises:
            DeviceFault: The connection fails; the message says what to check.
        """
        self._address = address
        self._socket: socket.socket | None = self._connect()

    def _connect(self) -> socket.socket:
        try:
            peer = socket.create_connection((self._address, PORT), CONNECT_TIME)
        except OSError as err:
            raise DeviceFault(
                f"{self._address}: no gripper on port {PORT} ({err}); check the address of the UR controller, "
                "that the URCap Robotiq Grippers is installed, and that its page on the pendant shows the gripper"
            ) from err
        peer.settimeout(ANSWER_TIME)
        return peer

    def read(self) -> RobotiqStatus:
        """Read all registers at once."""
        begin = time.monotonic()
        words = self._ask("".join(f"GET {name}\n" for name in self._NAMES), 2 * len(self._NAMES))
        try:
            values = {name: int(value) for name, value in zip(words[::2], words[1::2], strict=True)}
            activation, goes, found, fault, request, position = (values[name] for name in self._NAMES)
        except (ValueError, KeyError) as err:
            raise DeviceFault(
                f"{self._address}: port {PORT} answers {' '.join(words)!r}; check that the URCap Robotiq Grippers is "
                "installed and the gripper connected"
            ) from err
        return RobotiqStatus(
            activation=activation, goes=goes, object=found, fault=fault, request=request, position=position, time=begin
        )

    def write(self, *, activate: bool, go: bool, position: int, speed: int, force: int) -> None:
        """Write all registers at once."""
        values = f"ACT {activate:d} POS {position} SPE {speed} FOR {force} GTO {go:d}" if activate else "ACT 0 GTO 0"
        if (words := self._ask(f"SET {values}\n", 1)) != ["ack"]:
            raise DeviceFault(f"{self._address}: the gripper answers {' '.join(words)!r} to SET {values}")

    def close(self) -> None:
        """Disconnect."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _ask(self, request: str, count: int) -> list[str]:
        """Send a request and return the words of the answer; `ack` has no line end."""
        peer = self._socket = self._socket or self._connect()
        received, is_whole = b"", False
        try:
            peer.sendall(request.encode())
            while not is_whole:
                if not (data := peer.recv(1024)):
                    raise DeviceFault(f"{self._address}: the URCap closed the connection to port {PORT}")
                received += data
                is_whole = received.startswith(b"?") or (
                    len(received.split()) >= count and received.endswith((b"\n", b"ack"))
                )
        except OSError as err:
            raise DeviceFault(f"{self._address}: the gripper does not answer on port {PORT} ({err})") from err
        finally:
            if not is_whole:
                self.close()  # a late answer must not be taken for that to the next request
        return [word.decode("ascii", "replace") for word in received.split()]


def status_of(registers: Sequence[int], read_at: float) -> RobotiqStatus:
    """Return the status in the three input registers of Modbus, read at this time on the monotonic clock [s]."""
    status, fault, position = registers
    return RobotiqStatus(
        activation=status >> 12 & 3, goes=status >> 11 & 1, object=status >> 14 & 3, fault=fault >> 8 & 15,
        request=fault & 255, position=position >> 8, time=read_at,
    )  # fmt: skip


def registers_of(activate: bool, go: bool, position: int, speed: int, force: int) -> list[int]:
    """Return the three output registers of Modbus."""
    return [(activate | go << 3) << 8, position, speed << 8 | force]


class ModbusLine:
    """Modbus RTU on a serial line, 115200 baud, device 9."""

    def __init__(self, address: str) -> None:
        """Open the line.

        Args:
            address: Path or place of the serial port.

        Raises:
            MissingDependency: pymodbus is not installed.
            InvalidSetup: Nothing with a port is at this place.
            DeviceFault: The line cannot be opened.
        """
        self._path = path = port_at(address, "serial line")
        modbus = package_of("robotiq", "pymodbus.client", "A gripper on a serial line needs")
        self._error = package_of("robotiq", "pymodbus", "A gripper on a serial line needs").ModbusException
        os.close(claim(path, "serial line"))  # the library locks it, too, but does not say who has it
        self._client = modbus.ModbusSerialClient(path, baudrate=BAUD_RATE, timeout=0.1, retries=0)
        self._require_open()

    def _require_open(self) -> None:
        """Open the line unless it is open; the library closes it after some requests without an answer."""
        if not self._client.connect():
            raise DeviceFault(
                f"{self._path}: the serial line cannot be opened; check that the adapter is plugged in (ls -l "
                f"{self._path}) and that no other program uses it"
            )

    def read(self) -> RobotiqStatus:
        """Read the three input registers."""
        begin = time.monotonic()
        return status_of(self._call("read_holding_registers", FIRST_INPUT, count=3).registers, begin)

    def write(self, *, activate: bool, go: bool, position: int, speed: int, force: int) -> None:
        """Write the three output registers."""
        self._call("write_registers", FIRST_OUTPUT, registers_of(activate, go, position, speed, force))

    def close(self) -> None:
        """Close the line."""
        self._client.close()

    def _call(self, name: str, *values: Any, **more: Any) -> Any:
        self._require_open()
        try:
            self._client.socket.reset_input_buffer()  # a late answer is not that to the next request
            answer = getattr(self._client, name)(*values, device_id=MODBUS_DEVICE, **more)
        except (self._error, OSError, termios.error) as err:
            raise DeviceFault(
                f"{self._path}: no gripper answers ({err}); check its 24 V supply and the wiring of RS-485"
            ) from err
        if answer.isError():
            raise DeviceFault(f"{self._path}: the gripper refuses: {answer}")
        return answer
