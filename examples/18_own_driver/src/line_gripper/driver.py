"""The driver of a gripper that takes lines of text over TCP.

A request is a line, and so is its answer: `ok` with values, or `error` with a reason.

    state           ok OPENING CLOCK MOVING     opening 0 to 1, the device's clock [s], 0 or 1
    move OPENING FORCE                          force [N]; switches the motor on
    stop            ok                          stays where it is
    reset           ok                          leaves its fault
    off             ok                          switches the motor off
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Mapping
from typing import Any

from rcs.devices import Gripper, GripperState
from rcs.errors import DeviceFault, InvalidSetup, require_fields
from rcs.hardware import Driver
from rcs.robots import GripperDescription

PORT = 7007
PATIENCE = 0.5
"""Time without an answer after which the link counts as lost [s]."""


class LineGripper(Gripper):
    """A gripper at an address. The interface has checked order, limits and fault before it calls these functions."""

    def __init__(self, address: str, about: GripperDescription) -> None:
        """Connect to nothing yet; `address` is `HOST` or `HOST:PORT`."""
        super().__init__(f"{about.name} at {address}", about.max_width, about.max_force)
        host, _, port = address.partition(":")
        if not host or not (port or str(PORT)).isdigit():
            raise InvalidSetup(f"The address of a gripper is {address!r}; valid is 'HOST' or 'HOST:PORT'.")
        self._place = host, int(port or PORT)
        self._lock = threading.Lock()  # a stop may come from any thread
        self._socket: socket.socket | None = None
        self._is_moving = False

    def _open(self) -> None:
        """Connect and read; nothing is switched on."""
        self._connect()
        self._ask("state")

    def _state(self) -> GripperState:
        """Measure; raise if there is no answer."""
        opening, clock, moving = self._ask("state")
        self._is_moving = moving == "1"
        return GripperState(float(opening), device_time=float(clock))

    def _command_opening(self, opening: float, force: float | None) -> None:
        """Send a target and return at once."""
        self._ask("move", opening, self.max_force if force is None else force)

    def _has_arrived(self) -> bool:
        self._state()
        return not self._is_moving

    def _hold(self) -> None:
        """Stop and stay, from any thread; raise if that is impossible."""
        self._ask("stop")

    def _recover(self) -> None:
        """Leave the fault; nothing moves."""
        self._disconnect()
        self._connect()
        self._ask("reset")

    def _close(self) -> None:
        """Let go, also when the link is lost."""
        try:
            if self._socket is not None:
                self._ask("off")
        except DeviceFault:  # it is lost; the gripper has a watchdog of its own
            pass
        finally:
            self._disconnect()

    def _connect(self) -> None:
        try:
            self._socket = socket.create_connection(self._place, PATIENCE)
        except OSError as err:
            raise DeviceFault(f"no gripper answers at {self._place[0]}:{self._place[1]}: {err}") from err
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def _disconnect(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _ask(self, *words: object) -> list[str]:
        """Send a request and return the values of its answer."""
        with self._lock:
            if self._socket is None:
                raise DeviceFault("the link is lost")
            try:
                self._socket.sendall((" ".join(map(str, words)) + "\n").encode())
                answer = b""
                while not answer.endswith(b"\n"):
                    if not (more := self._socket.recv(256)):
                        raise OSError("the gripper has closed the connection")
                    answer += more
            except OSError as err:  # a late answer must not be taken for that of the next request
                self._disconnect()
                raise DeviceFault(f"the link is lost: {err}") from err
        verdict, *values = answer.decode().split()
        if verdict != "ok":
            raise DeviceFault(" ".join(values))
        return values


class LineGripperDriver(Driver):
    """Driver of such grippers. The address is `HOST` or `HOST:PORT`; there are no options."""

    def gripper(self, address: str, about: GripperDescription, options: Mapping[str, Any]) -> LineGripper:
        """Return a gripper, not connected."""
        require_fields("option of a line gripper", options, ())
        return LineGripper(address, about)
