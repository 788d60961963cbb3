"""Connections to an xArm controller and its flange, its checks on a plain socket, and the meaning of its errors.

The vendor's library waits more than three minutes for a silent peer. Therefore port 502 is tested here before the
library connects.
"""

from __future__ import annotations

import contextlib
import io
import logging
import re
import socket
import struct
import threading
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any, Final

from rcs.errors import DeviceFault
from rcs.extras import package_of
from rcs.hardware.programs import program_of
from rcs.hardware.robotiq_lines import FIRST_INPUT, FIRST_OUTPUT, MODBUS_DEVICE, RobotiqStatus, registers_of, status_of

PORT: Final = 502
PATIENCE: Final = 1.5
"""Timeout for the controller's answers [s]."""
OLDEST: Final = (1, 9, 0)
"""First firmware version that reports joint speeds."""
AXES: Final = 7
TOOL_PATIENCE: Final = 0.1
"""Timeout for answers on the line at the flange [s]."""

CODE_WORDS: Final = {
    1: "emergency stop: release the button on the control box, then call recover()",
    2: "the emergency input of the control box is open: close it, then call recover()",
    3: "emergency stop of the three-state switch: release it, then call recover()",
    10: "the servos report an error, such as a failed supply: check power and cable, then call recover()",
    **{10 + n: f"joint{n} reports an error: check what loads or blocks it, let it cool down, then call recover()"
       for n in range(1, 8)},
    18: "the force sensor does not answer: check its cable",
    19: "the end effector does not answer: check its cable and its baud rate",
    21: "no inverse kinematics solution: the pose is out of reach, or the arm is stretched out",
    22: "the arm would hit itself",
    23: "a joint is at the end of its range: move it back in UFACTORY Studio (Live Control), in manual mode",
    24: "a joint was commanded too fast; lower the option `speed`, and check whether this machine is too busy",
    25: "the controller cannot plan a motion",
    26: "the controller's computer is too late: switch it off and on",
    27: "the controller got no answer inside the control box: switch it off and on",
    28: "the board at the flange does not answer: switch the control box off and on",
    30: "a joint measured too high a speed: something pushed it, or its servo is broken",
    31: "collision: the arm hit something, was pushed, or carries another load than the controller knows; check the "
    "cause, the payload (UFACTORY Studio) and the collision sensitivity, then call recover()",
    35: "the arm is at the safety boundary that is set in UFACTORY Studio",
    37: "the arm moved by itself in manual mode: set payload and mounting in UFACTORY Studio",
    38: "a joint's measurement is implausible: switch the control box off and ask the vendor",
    60: "the TCP was commanded faster than servo mode allows; lower the option `speed`",
}  # fmt: skip
"""Meaning of the controller's errors, by number; vendor's manual."""

STATE_WORDS: Final = {
    3: "the arm was paused (state 3), in UFACTORY Studio or by another program",
    4: "the arm was stopped (state 4), in UFACTORY Studio or by another program",
    5: "the mode or a setting was changed (state 5), in UFACTORY Studio or by another program",
}
"""Reason why the controller does not move the arm, by state; vendor's manual."""


def require_controller(address: str) -> None:
    """Check that the controller of an xArm7 answers and that its firmware is recent enough.

    Raises:
        DeviceFault: It does not, within `PATIENCE` seconds; the message says what to check.
    """
    until = time.monotonic() + PATIENCE
    try:
        with socket.create_connection((address, PORT), PATIENCE) as peer:
            answer = _ask_version(peer, address, until)
    except TimeoutError as err:
        raise DeviceFault(
            f"{address}: no answer on port {PORT}; check that the control box is on, its cable is plugged in, this "
            f"computer is in its network (ping {address}), and this is the address of an xArm"
        ) from err
    except ConnectionRefusedError as err:
        raise DeviceFault(
            f"{address}: nothing listens on port {PORT}; check the address of the xArm (it is on a sticker on the "
            "control box) and that it has started (a minute after it is switched on)"
        ) from err
    except OSError as err:
        raise DeviceFault(
            f"{address}: port {PORT} cannot be reached: {err}; check the address and the network (ping {address})"
        ) from err
    found = re.search(r"(\d+)\.(\d+)\.(\d+)", answer)
    if found is None:
        raise DeviceFault(f"{address}: port {PORT} answers {answer[:60]!r}, which names no firmware: it is no xArm")
    firmware = tuple(map(int, found.groups()))
    if firmware < OLDEST:
        raise DeviceFault(
            f"{address}: the controller has firmware {found[0]}; the driver needs {'.'.join(map(str, OLDEST))} or"
            " newer: update it in UFACTORY Studio (Settings, System, Firmware)"
        )
    axes = re.match(r"(\d+),", answer)
    if axes is not None and int(axes[1]) != AXES:
        raise DeviceFault(f"{address}: the arm there has {axes[1]} joints, an xArm7 has {AXES}; check the address")


def _ask_version(peer: socket.socket, address: str, until: float) -> str:
    peer.sendall(struct.pack(">3HB", 1, 2, 1, 1))
    data = b""
    while len(data) < 8 or len(data) < 6 + struct.unpack_from(">H", data, 4)[0]:
        peer.settimeout(max(until - time.monotonic(), 0.01))
        try:
            received = peer.recv(4096)
        except TimeoutError as err:
            raise DeviceFault(
                f"{address}: port {PORT} accepts the connection but sends nothing; the controller hangs or is starting,"
                " or this is not an xArm"
            ) from err
        if not received:
            raise DeviceFault(f"{address}: port {PORT} closed the connection; check that this is an xArm")
        data += received
        if struct.unpack(">H", data[2:4].ljust(2, b"\0"))[0] != 2 and len(data) >= 4:
            raise DeviceFault(f"{address}: port {PORT} answers {data[:20]!r}: this is not an xArm")
    return data[8:].rstrip(b"\0").decode("ascii", "replace")


def others_on(address: str) -> str:
    """Return a description of the other programs that are connected to a controller."""
    wanted = struct.unpack("=I", socket.inet_aton(socket.gethostbyname(address)))[0]
    sockets = {
        words[9]
        for line in Path("/proc/net/tcp").read_text().splitlines()[1:]
        if (words := line.split())[2] == f"{wanted:08X}:{PORT:04X}"
    }
    found: list[str] = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            links = {str(link.readlink()) for link in (process / "fd").iterdir()}
            if links & {f"socket:[{one}]" for one in sockets} and process.name != str(Path("/proc/self").readlink()):
                found.append(program_of(process.name))
        except OSError:  # it has ended or belongs to another user
            continue
    return " or ".join(found) or "on another machine, or UFACTORY Studio"


def connect(address: str) -> Any:
    """Return the library's connection to a controller that has answered.

    It does not subscribe to reports, since each answer to a command contains errors, too.

    Raises:
        MissingDependency: The library is not installed.
        DeviceFault: The controller no longer answers.
    """
    with _quietly():
        library = package_of("xarm", "xarm.wrapper", "The driver `xarm` needs")
        # The library also prints return values, and a warning about the mode for each setpoint.
        package_of("xarm", "xarm.core.utils.log", "The driver `xarm` needs").logger.setLevel(logging.CRITICAL)
        logging.getLogger("origin.print").setLevel(logging.CRITICAL)
        api = library.XArmAPI(
            address,
            is_radian=True,
            do_not_open=True,
            enable_report=False,
            timed_comm=False,
            check_simulation_mode=False,
            forbid_uds=True,
        )
        try:
            api.connect()
        except Exception as err:  # the library raises plain exceptions
            raise DeviceFault(f"{address}: {err}") from err
    return api


_ALONE: Final = threading.Lock()  # what the library changes is the process's


@contextlib.contextmanager
def _quietly() -> Generator[None]:
    """Log the library's output, and undo its change of the program's default socket timeout."""
    with _ALONE:
        timeout, said = socket.getdefaulttimeout(), io.StringIO()
        try:
            with contextlib.redirect_stdout(said):
                yield
        finally:
            socket.setdefaulttimeout(timeout)
        for line in said.getvalue().splitlines():
            logging.getLogger(__name__).debug(line)


class XarmTool:
    """Transport to a Robotiq gripper at the flange, on its own connection so that no setpoint waits for it."""

    def __init__(self, address: str) -> None:
        """Connect.

        Raises:
            DeviceFault: No controller answers; the message says what to check.
        """
        require_controller(address)
        self._address = address
        self._api = connect(address)
        self._api.set_timeout(TOOL_PATIENCE)

    def read(self) -> RobotiqStatus:
        """Read the three input registers."""
        begin = time.monotonic()
        answer = self._ask(struct.pack(">2B2H", MODBUS_DEVICE, 3, FIRST_INPUT, 3), 9)
        return status_of(struct.unpack(">3H", answer[3:9]), begin)

    def write(self, *, activate: bool, go: bool, position: int, speed: int, force: int) -> None:
        """Write the three output registers."""
        values = registers_of(activate, go, position, speed, force)
        self._ask(struct.pack(">2B2HB3H", MODBUS_DEVICE, 16, FIRST_OUTPUT, 3, 6, *values), 6)

    def close(self) -> None:
        """Disconnect."""
        self._api.disconnect()

    def _ask(self, frame: bytes, size: int) -> bytes:
        code, answer = self._api.set_rs485_data(list(frame), min_res_len=size)
        if code != 0 or len(answer) < size or answer[1] != frame[1]:
            raise DeviceFault(
                f"{self._address}: the gripper does not answer through the controller (the library returns {code});"
                " check its 24 V supply, its cable, and that the line at the flange is set to 115200 baud (UFACTORY"
                " Studio, Settings, Externals)"
            )
        return bytes(answer)
