"""Queries to a UR controller over plain sockets, each with a timeout.

The vendor's library waits forever for a silent peer while it holds the GIL. Therefore the functions here test the ports
before the library connects.
"""

from __future__ import annotations

import socket
import struct
import time
from typing import Final

from rcs.errors import DeviceFault

DASHBOARD, SCRIPT, RTDE = 29999, 30002, 30004
RTDE_VERSION: Final = 2
"""Version of RTDE that ur-rtde speaks."""
PATIENCE: Final = 2.0
"""Timeout for the answers on all ports together [s]."""
_ENDS: Final = 0.3
"""Timeout for the end of a program that has been stopped [s]; our choice."""

_PURPOSE = {DASHBOARD: "dashboard", SCRIPT: "script port", RTDE: "RTDE"}


class Dashboard:
    """The controller's dashboard server, which answers each line of text with a line."""

    def __init__(self, address: str, patience: float = PATIENCE) -> None:
        """Connect.

        Raises:
            DeviceFault: There is no timely answer, or not from a UR; the message says what to check.
        """
        self._address = address
        self._socket = _connect(address, DASHBOARD, patience)
        self._received = b""
        try:
            banner = self._line(patience)
            if "Universal Robots" not in banner:
                raise DeviceFault(
                    f"{address}: port {DASHBOARD} greets with {banner[:60]!r}: this is not a UR controller"
                )
        except BaseException:
            self.close()
            raise

    def ask(self, question: str, patience: float = 0.5) -> str:
        """Send a line and return the answer within `patience` [s].

        Raises:
            DeviceFault: There is no answer in time.
        """
        try:
            self._socket.sendall(question.encode() + b"\n")
        except OSError as err:
            raise DeviceFault(f"{self._address}: the connection to the dashboard is lost ({err})") from err
        return self._line(patience)

    def close(self) -> None:
        """Disconnect."""
        self._socket.close()

    def __enter__(self) -> Dashboard:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _line(self, patience: float) -> str:
        until = time.monotonic() + patience
        while b"\n" not in self._received:
            self._received += _receive(self._socket, self._address, DASHBOARD, until)
        line, _, self._received = self._received.partition(b"\n")
        return line.decode("utf-8", "replace").strip()


def require_controller(address: str) -> None:
    """Check that a UR controller answers on all required ports, in a version that ur-rtde supports.

    Raises:
        DeviceFault: It does not, within `PATIENCE` seconds; the message says what to check.
    """
    until = time.monotonic() + PATIENCE
    with Dashboard(address, PATIENCE) as dashboard:
        software = dashboard.ask("PolyscopeVersion", until - time.monotonic())
    with _connect(address, RTDE, until - time.monotonic()) as rtde:
        if not _accepts(rtde, address, RTDE_VERSION, until):
            spoken = next((version for version in (1, 3, 4) if _accepts(rtde, address, version, until)), None)
            theirs = "another version" if spoken is None else f"version {spoken}"
            newer = spoken is not None and spoken > RTDE_VERSION
            mend = "a newer ur-rtde (pip install -U ur-rtde)" if newer else "PolyScope 5.6 or newer on the controller"
            raise DeviceFault(
                f"{address}: the controller ({software}) speaks {theirs} of RTDE, ur-rtde speaks version "
                f"{RTDE_VERSION}; install {mend}"
            )
    _connect(address, SCRIPT, until - time.monotonic()).close()


def require_ready_for_program(address: str) -> None:
    """Check that the controller accepts a program, without switching on, unlocking or stopping anything.

    Raises:
        DeviceFault: The arm is off, stopped, in local control, or runs another program.
    """
    with Dashboard(address) as dashboard:
        safety, mode = status_of(dashboard)
        if safety not in ("NORMAL", "REDUCED"):
            raise DeviceFault(f"{address}: {SAFETY_WORDS.get(safety, f'the safety status is {safety}')}")
        if mode != "RUNNING":
            raise DeviceFault(f"{address}: {MODE_WORDS.get(mode, f'the robot mode is {mode}')}")
        if dashboard.ask("is in remote control").lower() == "false":
            raise DeviceFault(
                f"{address}: the controller is in local control; choose Remote Control at the top right of the pendant "
                "(it must be enabled in Settings > System > Remote Control)"
            )
        until = time.monotonic() + _ENDS
        while dashboard.ask("running").lower().endswith("true"):
            if time.monotonic() > until:
                raise DeviceFault(
                    f"{address}: a program already runs on the controller, from the pendant or another computer; stop "
                    "it"
                )
            time.sleep(0.01)


SAFETY_WORDS: Final = {
    "PROTECTIVE_STOP": "protective stop: the arm hit something, was pushed or overloaded, or was moved too fast; check "
    "the cause on the pendant, then call recover(), which unlocks it (5 s after the stop at the earliest)",
    "SAFEGUARD_STOP": "safeguard stop: a gate is open or a light curtain is broken; close it",
    "SYSTEM_EMERGENCY_STOP": "emergency stop from outside: release its button, then switch the arm on at the pendant",
    "ROBOT_EMERGENCY_STOP": "emergency stop: release the button, then switch the arm on at the pendant",
    "VIOLATION": "safety violation: read the message on the pendant and restart the safety system there",
    "FAULT": "safety fault: read the message on the pendant; switch the controller off and on",
    "RECOVERY": "recovery mode: a joint is outside its safety limits; move it back at the pendant",
}
"""Meaning of a safety status, by the dashboard's names."""

MODE_WORDS: Final = {
    "POWER_OFF": "the arm is switched off; switch it on at the pendant and release the brakes",
    "POWER_ON": "the arm is being switched on; wait, then release the brakes at the pendant",
    "IDLE": "the brakes are engaged; release them at the pendant (Start)",
    "BACKDRIVE": "the joints are in backdrive; release the button on the pendant",
    "BOOTING": "the arm is starting; wait",
    "DISCONNECTED": "the controller does not reach the arm; check the cable between them",
    "CONFIRM_SAFETY": "the pendant asks to confirm the safety configuration",
    "NO_CONTROLLER": "the controller's software is starting; wait",
}
"""Meaning of a robot mode, by the dashboard's names."""


def status_of(dashboard: Dashboard) -> tuple[str, str]:
    """Return the safety status and the robot mode, by the dashboard's names."""
    safety = dashboard.ask("safetystatus").partition(":")[2].strip().upper()
    return safety, dashboard.ask("robotmode").partition(":")[2].strip().upper()


def unlock(address: str, patience: float = 10.0) -> None:
    """Unlock a protective stop as soon as the controller permits, within `patience` [s]; nothing moves.

    Raises:
        DeviceFault: It stays locked, or the arm is not ready for another reason; the message says what to do.
    """
    until = time.monotonic() + patience
    with Dashboard(address) as dashboard:
        safety, mode = status_of(dashboard)
        answer = ""
        while safety == "PROTECTIVE_STOP" and time.monotonic() < until:
            answer = dashboard.ask("unlock protective stop")
            time.sleep(0.1)
            safety, mode = status_of(dashboard)
        if safety == "PROTECTIVE_STOP":
            raise DeviceFault(f"{address}: the protective stop remains: {answer}")
        if safety not in ("NORMAL", "REDUCED"):
            raise DeviceFault(f"{address}: {SAFETY_WORDS.get(safety, f'the safety status is {safety}')}")
        if mode != "RUNNING":
            raise DeviceFault(f"{address}: {MODE_WORDS.get(mode, f'the robot mode is {mode}')}")


def _accepts(rtde: socket.socket, address: str, version: int, until: float) -> bool:
    """Return True if the controller supports a version of RTDE."""
    rtde.sendall(struct.pack(">HBH", 5, ord("V"), version))
    data = b""
    while True:
        while len(data) < 3 or len(data) < struct.unpack_from(">H", data)[0]:
            data += _receive(rtde, address, RTDE, until)
        size, kind = struct.unpack_from(">HB", data)
        if kind == ord("V") and size == 4:
            return data[3] == 1
        if size < 3:
            raise DeviceFault(
                f"{address}: port {RTDE} answers {data[:20]!r}, which is not RTDE: this is not a UR controller"
            )
        data = data[size:]  # a text message may precede the answer


def _connect(address: str, port: int, patience: float) -> socket.socket:
    try:
        return socket.create_connection((address, port), max(patience, 0.01))
    except TimeoutError as err:
        raise DeviceFault(
            f"{address}: no answer on port {port} ({_PURPOSE[port]}); check that the controller is on, its cable "
            f"is plugged in, and this computer is in its network (ping {address})"
        ) from err
    except ConnectionRefusedError as err:
        raise DeviceFault(
            f"{address}: nothing listens on port {port} ({_PURPOSE[port]}); check the address of the UR controller "
            "(Settings > System > Network) and that the service is enabled (Settings > Security > Services)"
        ) from err
    except OSError as err:
        raise DeviceFault(
            f"{address}: port {port} ({_PURPOSE[port]}) cannot be reached: {err}; check the address and the network "
            f"(ping {address})"
        ) from err


def _receive(peer: socket.socket, address: str, port: int, until: float) -> bytes:
    try:
        peer.settimeout(max(until - time.monotonic(), 0.01))
        data = peer.recv(4096)
    except TimeoutError as err:
        raise DeviceFault(
            f"{address}: port {port} ({_PURPOSE[port]}) accepts the connection but sends nothing; the controller hangs "
            "or is starting, or this is not a UR controller"
        ) from err
    except OSError as err:
        raise DeviceFault(f"{address}: the connection to port {port} ({_PURPOSE[port]}) broke: {err}") from err
    if not data:
        raise DeviceFault(f"{address}: the controller closed the connection to port {port} ({_PURPOSE[port]})")
    return data


def stop_program(address: str) -> None:
    """End the controller's program; the arm brakes at once.

    Raises:
        DeviceFault: The controller does not answer, or the program still runs.
    """
    with Dashboard(address, 0.3) as dashboard:
        answer = dashboard.ask("stop", 0.3)
        if answer.lower().startswith("stopped"):
            return
        # Without a program, as after a protective stop, the command may fail.
        if not dashboard.ask("running", 0.3).lower().endswith("false"):
            raise DeviceFault(f"{address}: the program cannot be stopped: {answer}")
