"""How a Robotiq gripper is reached: over the socket of the URCap on a UR controller, or Modbus RTU on a serial line."""

from __future__ import annotations

import socket
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

from rcs.errors import DeviceFault
from rcs.extras import package_of

PORT: Final = 63352
"""Of the URCap's socket."""
MODBUS_DEVICE: Final = 9
FIRST_OUTPUT: Final = 0x03E8
FIRST_INPUT: Final = 0x07D0
BAUD_RATE: Final = 115200
CONNECT_TIME: Final = 0.4
"""How long a connection may take [s]."""
ANSWER_TIME: Final = 0.1
"""How long the URCap may take for an answer [s]; usually it takes 2 to 20 ms."""


@dataclass(frozen=True, kw_only=True)
class RobotiqStatus:
    """What the gripper says of itself, by the names of its manual."""

    activation: int
    """STA: 0 reset, 1 under way, 3 activated."""
    goes: int
    """GTO: whether it goes to the position that is requested."""
    object: int
    """OBJ: 0 moving, 1 and 2 stopped by something while opening and closing, 3 there."""
    fault: int
    """FLT."""
    request: int
    """PRE: the position that is requested."""
    position: int
    """POS: 0 open … 255 closed."""
    time: float
    """When it was read, on the host's monotonic clock [s]."""


class Transport(Protocol):
    """A way to reach the gripper's registers; one call at a time. Calls raise `DeviceFault`."""

    def read(self) -> RobotiqStatus:
        """Read all input registers."""
        ...

    def write(self, *, activate: bool, go: bool, position: int, speed: int, force: int) -> None:
        """Write all output registers."""
        ...

    def close(self) -> None:
        """Let go."""
        ...


class UrcapSocket:
    """The socket of Robotiq's URCap."""

    _NAMES = ("STA", "GTO", "OBJ", "FLT", "PRE", "POS")

    def __init__(self, address: str) -> None:
        """Connect.

        Raises:
            DeviceFault: Nobody is there; says what to look at.
        """
        self._address = address
        self._socket: socket.socket | None = self._connect()

    def _connect(self) -> socket.socket:
        try:
            peer = socket.create_connection((self._address, PORT), CONNECT_TIME)
        except OSError as err:
            raise DeviceFault(
                f"{self._address}: no gripper on port {PORT} ({err}); is this the address of the UR controller, is the "
                "URCap Robotiq Grippers installed, and does its page on the pendant see the gripper?"
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
                f"{self._address}: port {PORT} answers {' '.join(words)!r}; is this the URCap Robotiq Grippers, and is "
                "the gripper connected?"
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
        """Hang up."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _ask(self, request: str, count: int) -> list[str]:
        """Send something and return the words of the answer; `ack` comes without an end of line."""
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
                self.close()  # an answer that comes late must not be taken for that to the next question
        return [word.decode("ascii", "replace") for word in received.split()]


def status_of(registers: Sequence[int], read_at: float) -> RobotiqStatus:
    """Return what the three input registers of Modbus say, read at a time on the monotonic clock [s]."""
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

    def __init__(self, path: str) -> None:
        """Open the line.

        Raises:
            MissingDependency: pymodbus is not installed.
            DeviceFault: The line cannot be opened.
        """
        self._path = path
        modbus = package_of("robotiq", "pymodbus.client", "A gripper on a serial line needs")
        self._error = package_of("robotiq", "pymodbus", "A gripper on a serial line needs").ModbusException
        self._client = modbus.ModbusSerialClient(path, baudrate=BAUD_RATE, timeout=0.1, retries=0)
        if not self._client.connect():
            raise DeviceFault(
                f"{path}: the serial line cannot be opened; is the adapter plugged in (ls -l {path}), and may you use "
                "it (sudo usermod -aG dialout $USER, then log in anew)?"
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
        try:
            self._client.socket.reset_input_buffer()  # an answer that came late is not that to the next question
            answer = getattr(self._client, name)(*values, device_id=MODBUS_DEVICE, **more)
        except (self._error, OSError) as err:
            raise DeviceFault(
                f"{self._path}: no gripper answers ({err}); has it 24 V, and are the wires of RS-485 in their places?"
            ) from err
        if answer.isError():
            raise DeviceFault(f"{self._path}: the gripper refuses: {answer}")
        return answer
