"""Robotiq 2F grippers, over the URCap's socket on a UR controller or over Modbus RTU on a serial line.

Reading takes 2 to 20 ms. Therefore a thread reads the gripper and sends the commands; `state` returns the last reading
with its time.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final

from msgspec import Meta
from rcs_data.options import Record

from rcs.devices import Gripper, GripperState
from rcs.errors import DeviceFault, InvalidAction, InvalidSetup
from rcs.hardware.driver import Driver, require_address
from rcs.hardware.robotiq_lines import ANSWER_TIME, ModbusLine, RobotiqStatus, Transport, UrcapSocket
from rcs.hardware.usb import BY_PATH
from rcs.robots.description import GripperDescription

PERIOD: Final = 0.02
"""Time between two readings [s]."""
SILENCE: Final = 0.4
"""Time of failed readings after which the gripper is at fault [s]."""
PATIENCE: Final = 0.05
"""Longest wait of `hold` for a busy line [s]; after that, the thread sends the stop."""
ACTIVATION_TIME: Final = 10.0
"""Timeout of an activation [s]; about 3 s according to the vendor."""

SLOWEST, FASTEST = 0.020, 0.150
"""Speeds of the width [m/s] at register values 0 and 255; vendor's data sheet of the 2F-85."""
WEAKEST, STRONGEST = 20.0, 235.0
"""Forces [N] at register values 0 and 255; same source."""

_ACTIVE = 3
_IS_MOVING = 0

FAULTS: Final = {
    0x05: "it waits for the end of its activation",
    0x07: "it is no longer activated; its power may have failed",
    0x08: "it is hotter than 85 °C; let it cool down",
    0x09: "it has received nothing for 1 s",
    0x0A: "its supply is below 21.6 V; check its power supply and cable",
    0x0B: "an automatic release is in progress",
    0x0C: "its processor has a fault; switch it off and on",
    0x0D: "its activation failed; check whether something blocks the fingers",
    0x0E: "its current is too high; check whether something blocks the fingers",
    0x0F: "it has released automatically; activate it again",
}
"""Codes of register FLT; vendor's instruction manual."""
_HARMLESS = (0, 0x05, 0x09)


class RobotiqOptions(Record):
    """A site's options for a Robotiq gripper."""

    speed: Annotated[float, Meta(ge=SLOWEST, le=FASTEST)] = FASTEST
    """Speed of the width [m/s]."""
    force: Annotated[float, Meta(ge=WEAKEST, le=STRONGEST)] | None = None
    """Force of commands without one [N]; None for the description's."""
    open: Annotated[float, Meta(ge=0, le=255)] = 3
    """Position of the open fingers, in the units of register POS."""
    closed: Annotated[float, Meta(ge=0, le=255)] = 230
    """Position of the closed fingers; above `open`."""

    def __post_init__(self) -> None:
        """Check every field.

        Raises:
            InvalidSetup: A value is invalid.
        """
        super().__post_init__()
        if not self.open < self.closed:
            raise InvalidSetup(f"open is {self.open} and closed is {self.closed}; open must be less than closed.")


@dataclass(frozen=True)
class _Order:
    """A command to the fingers, in register units."""

    position: int
    force: int


class RobotiqGripper(Gripper):
    """A 2F-85 or 2F-140. The first command activates it if necessary; its fingers then open and close fully."""

    def __init__(
        self,
        address: str,
        about: GripperDescription,
        options: Mapping[str, Any],
        transport: Callable[[str], Transport] | None = None,
    ) -> None:
        """Create the gripper; `open` connects.

        Args:
            address: IP address of the UR controller, or path or place (`usb:1-2.3`) of a serial line.
            about: Description of the gripper.
            options: Those of `RobotiqOptions`.
            transport: Makes the transport of an address; None for a serial line if it is a path or a place, else for
                the URCap's socket.

        Raises:
            InvalidSetup: An option does not exist or has an invalid value.
        """
        require_address("Robotiq gripper", address)
        if not about.name.startswith("robotiq"):
            raise InvalidSetup(f"This is the driver of Robotiq's grippers, not of {about.name!r}; use another driver.")
        given = RobotiqOptions.from_json(options)
        super().__init__(f"{about.name} at {address}", about.max_width, about.max_force)
        self._address = address
        self._force = about.grasp_force if given.force is None else given.force
        self._open_at, self._closed_at = given.open, given.closed
        self._speed = round(255 * (given.speed - SLOWEST) / (FASTEST - SLOWEST))
        self._connect = transport or (ModbusLine if address.startswith(("/", BY_PATH)) else UrcapSocket)
        self._transport: Transport | None = None
        self._lock = threading.RLock()  # for the transport; commands do not wait for a silent line
        self._wake = threading.Event()
        self._thread: threading.Thread | None = None
        self._is_ending = self._must_stop = False
        self._order: _Order | None = None
        self._sent: _Order | None = None
        self._was_active = False
        self._activating_since = math.nan  # when a command first needed an activation
        self._activation_began = -math.inf
        self._moved = 0.0
        self._status: RobotiqStatus | None = None

    def _open(self) -> None:
        self._transport = self._connect(self._address)
        try:
            self._take(self._transport.read())
        except BaseException:
            self._close()
            raise
        self._is_ending = self._was_active = self._must_stop = False
        self._order = self._sent = None
        self._activating_since = math.nan
        self._thread = threading.Thread(target=self._serve, name=f"rcs-robotiq-{self._address}", daemon=True)
        self._thread.start()

    def _close(self) -> None:
        self._is_ending = True
        self._wake.set()
        if self._thread is not None:
            self._thread.join(2.0)
            self._thread = None
        if self._transport is not None:
            self._transport.close()
            self._transport = None

    def _state(self) -> GripperState:
        status = self._status
        assert status is not None, "a call before `open` is refused by the interface"
        self._require_fresh(status)
        opening = (self._closed_at - status.position) / (self._closed_at - self._open_at)
        return GripperState(min(max(opening, 0.0), 1.0), time=status.time)

    def _require_fresh(self, status: RobotiqStatus) -> None:
        if (age := time.monotonic() - status.time) > 2 * SILENCE:
            raise DeviceFault(f"the gripper has sent nothing for {age:.1f} s; check its cable and its power supply")

    def _command_opening(self, opening: float, force: float | None) -> None:
        wanted = self._force if force is None else force
        if wanted < WEAKEST:
            raise InvalidAction(
                f"{self.name}: force is {wanted:g} N; valid is {WEAKEST:g} to {self.max_force:g}, as the gripper "
                "cannot hold more gently."
            )
        share = min((wanted - WEAKEST) / (STRONGEST - WEAKEST), 1.0)
        position = round(self._closed_at + opening * (self._open_at - self._closed_at))
        self._order = _Order(position, round(255 * share))
        self._wake.set()

    def _has_arrived(self) -> bool:
        order, sent = self._order, self._sent
        status = self._status  # read after the last command was sent
        assert status is not None, "a call before `open` is refused by the interface"
        if order is None:  # held, or never commanded
            return status.time - self._moved > 2 * PERIOD
        is_told = sent == order and status.request == order.position
        return is_told and status.activation == _ACTIVE and status.object != _IS_MOVING

    def _hold(self) -> None:
        status = self._status
        if status is None:
            return
        self._order, self._activating_since = None, math.nan
        age = time.monotonic() - status.time
        # Do not wait for a silent line: other devices must be held, too. After a longer time, the thread itself may
        # have been blocked, for example by a library that shuts down, and the line may be fine.
        if not ANSWER_TIME < age <= 2 * SILENCE and self._lock.acquire(timeout=PATIENCE):
            try:
                if self._transport is not None:
                    self._stop(self._transport, self._transport.read() if age > ANSWER_TIME else status)
            finally:
                self._lock.release()
            return
        self._must_stop = True
        self._wake.set()
        self._require_fresh(status)

    def _stop(self, transport: Transport, status: RobotiqStatus) -> None:
        """Stop the fingers."""
        if self._sent is not None:  # otherwise there has been no command
            # Only a reset stops an activation.
            activate = status.activation == _ACTIVE
            transport.write(activate=activate, go=False, position=status.position, speed=0, force=0)
            self._sent = None
        self._must_stop = False

    def _recover(self) -> None:
        with self._lock:
            self._order = None
            transport, status = self._reached()
            if status.activation != _ACTIVE or status.fault not in _HARMLESS:
                # Nothing moves: the next command activates the gripper again.
                transport.write(activate=False, go=False, position=0, speed=0, force=0)
                status = transport.read()
                if status.fault not in (*_HARMLESS, 0x07, 0x0F):
                    raise DeviceFault(f"the fault persists: {FAULTS.get(status.fault, status.fault)}")
            self._was_active = False
            self._take(status)

    def _reached(self) -> tuple[Transport, RobotiqStatus]:
        """Return the transport with a status, a new one if the gripper does not answer through the old one."""
        assert self._transport is not None, "a call before `open` is refused by the interface"
        with contextlib.suppress(DeviceFault):
            return self._transport, self._transport.read()
        self._transport.close()
        try:
            self._transport = self._connect(self._address)
        except InvalidSetup as err:  # nothing is at its place
            raise DeviceFault(str(err)) from err
        return self._transport, self._transport.read()

    # --- The thread ---

    def _serve(self) -> None:
        """Read the gripper and send commands until the thread ends."""
        while True:
            self._wake.wait(PERIOD)
            self._wake.clear()
            if self._is_ending:
                return
            try:
                self._exchange()
            except Exception as err:  # noqa: BLE001  whatever it is, it is the gripper's fault
                assert self._status is not None
                if not self.fault and time.monotonic() - self._status.time > SILENCE:
                    self.set_fault(str(err) if isinstance(err, DeviceFault) else f"{type(err).__name__}: {err}")

    def _stop_late(self, transport: Transport) -> None:
        """Send a stop that `hold` has left to this thread."""
        if self._must_stop:
            assert self._status is not None
            self._stop(transport, self._status)

    def _exchange(self) -> None:
        with self._lock:
            transport = self._transport
            if transport is None:
                return
            self._stop_late(transport)
            if not self.fault:
                self._follow(transport)
            status = transport.read()  # during a fault, too, to keep measurements fresh
            self._take(status)
        if not self.fault:
            self._judge(status)

    def _follow(self, transport: Transport) -> None:
        """Send the newest command, once the gripper is activated."""
        assert self._status is not None
        order = self._order
        if order is None or order == self._sent:
            return
        if self._status.activation != _ACTIVE:
            self._activate(transport)
            return
        self._activating_since = math.nan
        transport.write(activate=True, go=True, position=order.position, speed=self._speed, force=order.force)
        self._sent = order

    def _activate(self, transport: Transport) -> None:
        """Begin an activation unless one is in progress; the command waits for its end."""
        assert self._status is not None
        now = time.monotonic()
        if math.isnan(self._activating_since):
            self._activating_since = now
        if now - self._activating_since > ACTIVATION_TIME:
            self._activating_since = math.nan
            self.set_fault(
                f"its activation has not ended after {ACTIVATION_TIME:g} s; does something block the fingers, and has "
                "the gripper its 24 V?"
            )
        elif self._status.activation == 0 and now - self._activation_began > 1.0:  # the status changes after a moment
            self._sent = _Order(-1, 0)  # so that `_hold` stops it
            transport.write(activate=False, go=False, position=0, speed=0, force=0)
            transport.write(activate=True, go=False, position=0, speed=0, force=0)
            self._activation_began = now

    def _take(self, status: RobotiqStatus) -> None:
        if self._status is None or status.position != self._status.position:
            self._moved = status.time
        self._status = status

    def _judge(self, status: RobotiqStatus) -> None:
        """Enter the fault state if the gripper reports a fault."""
        if status.fault not in (*_HARMLESS, 0x07):
            self.set_fault(f"the gripper reports {status.fault:#x}: {FAULTS.get(status.fault, 'see its manual')}")
        elif self._was_active and status.activation == 0:
            self.set_fault(
                "the gripper has lost its activation, for example by a power cut; after recover(), the next command "
                "activates it: its fingers then open and close fully"
            )
        self._was_active = self._was_active or status.activation == _ACTIVE


class RobotiqDriver(Driver):
    """Driver of Robotiq grippers, at the IP address of a UR controller, or the path or place of a serial line."""

    hosted = True

    def gripper(self, address: str, about: GripperDescription, options: Mapping[str, Any]) -> RobotiqGripper:
        """Return a gripper; nothing is connected."""
        return RobotiqGripper(address, about, options)
