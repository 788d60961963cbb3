"""The driver of the Tilburg Hand, by its vendor's library.

The library prints, returns 512 for motors that do not answer, changes the lists that it is given, writes into the home
folder, and switches the motors on when it connects. Here it opens the port, finds the motors and reads its calibration;
all requests after that are checked one by one.
"""

from __future__ import annotations

import contextlib
import io
import json
import logging
import math
import os
import tempfile
import termios
import threading
import time
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray
from rcs_data.options import Record

from rcs.devices import Hand, HandState
from rcs.errors import DeviceFault, InvalidSetup
from rcs.extras import package_of
from rcs.hardware.driver import Driver, HostTimes
from rcs.hardware.serial_port import claim, port_at
from rcs.robots.description import HandDescription

_log = logging.getLogger(__name__)

LEAST_CURRENT, CURRENT, MOST_CURRENT = 20, 400, 1000
"""Current of a motor: least, usual and greatest [mA]. The XL330-M288 has 0.52 Nm at its stall current of 1470 mA
(ROBOTIS e-manual); the hand's joints are made for 0.35 Nm."""
SUCCESS = 0
"""Result of a request of dynamixel_sdk."""
MODE, TORQUE, ERRORS, GOAL_CURRENT, GOAL, SPEED, POSITION = 11, 64, 70, 102, 116, 128, 132
"""Registers of the XL330 (ROBOTIS e-manual)."""
CURRENT_BASED_POSITION = 5
ERROR_BITS = {
    0x01: "its supply voltage is out of range",
    0x04: "it is too hot",
    0x10: "it got an electrical shock",
    0x20: "it is overloaded",
}
"""Bits of the register of errors (ROBOTIS e-manual)."""
ALERT = 0x80
"""Bit in every answer of a motor with an error (Protocol 2.0)."""
SETTLING = 0.02
"""Time within which a late answer comes [s]; adapters buffer input for up to 16 ms."""
REBOOTING = 0.5
"""Time after which a motor that was restarted answers again [s]; our choice."""
CHECK_EVERY = 0.25
"""Time between two looks at the motors' errors [s]."""
NEAR, STILL = 0.02, 2
"""Distance from its target at which a joint has arrived [1], and speed below which it is at rest [0.229 rev/min]."""
BEGINNING = 0.2
"""Time until commanded fingers begin to move [s]."""
TRIES = 5
"""How often a motor is asked before it counts as lost; the library waits for an answer for about 35 ms."""


class TilburgOptions(Record):
    """A site's options for a Tilburg Hand."""

    current: Annotated[float, Meta(ge=LEAST_CURRENT, le=MOST_CURRENT)] = CURRENT
    """Largest current of each motor [mA]."""
    calibration: str | None = None
    """Path of a calibration file of the vendor's library; None for its default."""
    side: Literal["right", "left"] = "right"
    """Which hand it is."""
    at_close: Literal["release", "hold"] = "release"
    """When the hand is closed, `release` switches the motors off; `hold` leaves them on."""


class TilburgDriver(Driver):
    """Driver of Tilburg Hands. The address is a serial port, or serial number or place of its adapter."""

    hosted = True
    host_times = HostTimes(open=10.0, answer=1.0)

    def hand(self, address: str, about: HandDescription, options: Mapping[str, Any]) -> TilburgHand:
        """Return a hand."""
        return TilburgHand(address, about, options)


class TilburgHand(Hand):
    """A hand whose motors are switched on by the first command, with bounded currents."""

    def __init__(self, address: str, about: HandDescription, options: Mapping[str, Any]) -> None:
        """Open nothing yet.

        Raises:
            InvalidSetup: An option is not valid, or there is no address.
        """
        given = TilburgOptions.from_json(options)
        if not address:
            raise InvalidSetup("The Tilburg Hand has no address; give the serial number of its adapter, or its port.")
        file = None if given.calibration is None else Path(given.calibration).expanduser().resolve()
        if file is not None and not file.is_file():  # the library would use its default, and only print so
            raise InvalidSetup(f"There is no calibration file {file}; correct the option, or leave it out.")
        super().__init__(f"{about.name} at {address}", len(about.joints))
        self._address = self._path = address
        self._joints = about.joints
        self._current, self._side, self._releases = round(given.current), given.side, given.at_close == "release"
        self._calibration = None if file is None else str(file)
        self._bus = threading.RLock()  # `hold` comes from any thread
        self._library: Any = None
        self._motors: Sequence[int] = ()
        self._lowest = self._highest = np.zeros(self.joint_count)
        self._goal: NDArray[np.float64] | None = None
        self._checked = 0.0
        self._since = -math.inf  # time of the last command
        self._port: int | None = None  # locks it against other programs
        self._is_late = False  # an answer is missing, and may still come
        self._ready = np.zeros(self.joint_count, np.bool_)  # motors that are on, with bounded currents
        self._is_powered = False  # some may be on

    # --- Functions of the interface ---

    def _open(self) -> None:
        with self._bus:
            self._ready[:], self._goal = False, None
            self._connect()
            self._read(POSITION, 4)

    def _state(self) -> HandState:
        with self._bus:
            at = self._measure()
            if time.monotonic() - self._checked > CHECK_EVERY:
                self._require_no_error()
            return HandState(list(at))

    def _command_joints(self, joints: NDArray[np.float64]) -> None:
        with self._bus:
            if not self._ready.all():
                self._switch_on()
            self._goal, self._since = np.array(joints), time.monotonic()
            self._send(self._goal)

    def _has_arrived(self) -> bool:
        with self._bus:
            if self._goal is None or np.abs(self._measure() - self._goal).max() < NEAR:
                return True
            has_begun = time.monotonic() > self._since + BEGINNING
            return has_begun and bool(np.abs(self._read(SPEED, 4)).max() <= STILL)  # it presses on something

    def _hold(self) -> None:
        with self._bus:
            here = np.clip(self._measure(), 0.0, 1.0)  # raises if the link is lost
            if not self._is_powered:
                return
            goal = here if self._goal is None else self._goal
            # Fingers that press on an object keep pressing: to hold must not mean to drop it.
            is_moving = np.abs(self._read(SPEED, 4)) > STILL
            if time.monotonic() < self._since + BEGINNING:
                is_moving |= np.abs(here - goal) > NEAR
            self._goal = np.where(is_moving, here, goal)
            self._send(self._goal)

    def _recover(self) -> None:
        with self._bus:
            try:
                errors = self._read(ERRORS, 1)
            except (DeviceFault, OSError):
                self._disconnect()
                self._connect()
                errors = self._read(ERRORS, 1)
            if errors.any():
                self._reboot([motor for motor, bits in zip(self._motors, errors, strict=True) if bits])
            # Motors that are still on keep their goals, which a lost command has not changed: fingers that press on an
            # object must not drop it.
            self._ready &= self._read(TORQUE, 1) == 1
            if self._goal is not None:
                goals = (self._read(GOAL, 4) - self._lowest) / (self._highest - self._lowest)
                self._goal = np.clip(np.where(self._ready, goals, self._measure()), 0.0, 1.0)
            self._require_no_error()

    def _close(self) -> None:
        with self._bus:
            try:
                if self._is_powered and self._releases:
                    self._write_each(TORQUE, 1, 0)
                    self._is_powered = False
            except DeviceFault as err:  # the link is lost
                _log.warning("%s may still be powered: %s", self.name, err)
            finally:
                self._disconnect()

    # --- The library ---

    def _connect(self) -> None:
        module = package_of("tilburg", "tilburg_hand.motor_interface", "A Tilburg Hand needs")
        self._path = port_at(self._address, "hand")
        self._port = claim(self._path, "hand")
        try:
            self._find_motors(module)
        except BaseException:
            self._disconnect()
            raise

    def _find_motors(self, module: Any) -> None:
        told = io.StringIO()
        with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(told), _at_home(folder):
            library = module.TilburgHandMotorInterface(
                self._config(Path(module.__file__).parent, Path(folder)),
                calibration_file=self._calibration,
                hand_orientation=self._side,
            )
            self._library = library
            # It would switch the motors on, and ports without a setting for low latency would end it.
            library.set_torques = library.set_leds = lambda value=True: None
            set_latency = module._set_low_latency_mode
            module._set_low_latency_mode = lambda port, value: _low_latency(set_latency, port, value)
            try:
                is_connected = library.connect() == 1
            except Exception as err:
                raise DeviceFault(f"there is no hand at {self._address}: {err}") from err
            finally:
                module._set_low_latency_mode = set_latency
        if not is_connected:
            raise DeviceFault(f"there is no hand at {self._address}: {' '.join(told.getvalue().split())}")
        with contextlib.redirect_stdout(told):
            for _ in range(TRIES):  # a single lost answer is no missing motor
                if not all(library.motor_enabled[: self.joint_count]):
                    again = library.check_enabled_motors()
                    library.motor_enabled = [a or b for a, b in zip(library.motor_enabled, again, strict=True)]
        found = [name for name, answers in zip(self._joints, library.motor_enabled, strict=False) if answers]
        if missing := [name for name in self._joints if name not in found]:
            answering = ", ".join(found) or "none"
            raise DeviceFault(f"the motors of {', '.join(missing)} do not answer; those that do: {answering}")
        count = self.joint_count
        self._motors = library.joint_motor_mapping[:count]
        self._lowest = np.array(library.motor_calib_min_range_ticks[:count], np.float64)
        self._highest = np.array(library.motor_calib_max_range_ticks[:count], np.float64)

    def _config(self, package: Path, folder: Path) -> str:
        """Write a configuration with this port and return its path."""
        content = json.loads((package / "motorgui" / "config.json").read_text("utf-8"))
        content["motors_dynamixelsdk_port"] = self._path
        path = folder / "config.json"
        path.write_text(json.dumps(content), "utf-8")
        return str(path)

    def _disconnect(self) -> None:
        library, self._library = self._library, None
        port = None if library is None else library.dynamixel_portHandler
        if port is not None and port.is_open:
            port.closePort()
        if self._port is not None:
            os.close(self._port)
            self._port = None

    def _reboot(self, motors: Sequence[int]) -> None:
        """Restart motors with errors, which switches them off and clears the errors whose cause is gone."""
        library = self._connected()
        for motor in motors:
            library.dynamixel_packetHandler.reboot(library.dynamixel_portHandler, motor)
        time.sleep(REBOOTING)

    def _switch_on(self) -> None:
        """Bound the currents of the motors that are not ready, then switch these on where they are."""
        off = ~self._ready
        self._write_each(TORQUE, 1, 0, off)
        self._write_each(MODE, 1, CURRENT_BASED_POSITION, off)
        self._write_each(GOAL_CURRENT, 2, self._current, off)
        here = self._measure()
        self._send(here if self._goal is None else np.where(off, here, self._goal))
        self._is_powered = True
        self._write_each(TORQUE, 1, 1, off)
        self._ready[:] = True

    def _measure(self) -> NDArray[np.float64]:
        """Return the joints, 0 to 1 of their ranges."""
        return (self._read(POSITION, 4) - self._lowest) / (self._highest - self._lowest)

    def _send(self, joints: NDArray[np.float64]) -> None:
        ticks = self._lowest + joints * (self._highest - self._lowest)
        self._write_all(GOAL, 4, [round(one) for one in ticks.tolist()])

    def _require_no_error(self) -> None:
        self._checked = time.monotonic()
        errors = self._read(ERRORS, 1)
        self._ready &= errors == 0  # the others have switched themselves off
        for name, bits in zip(self._joints, errors.tolist(), strict=True):
            if bits:
                known = [words for bit, words in ERROR_BITS.items() if bits & bit]
                raise DeviceFault(
                    f"the motor of {name} has error {bits}: {'; '.join(known) or 'unknown'}. Check the supply and what "
                    "blocks the finger, then recover, which restarts the motor"
                )

    def _read(self, register: int, size: int) -> NDArray[np.int64]:
        """Read a register of all motors.

        Raises:
            DeviceFault: A motor does not answer.
        """
        library = self._connected()
        sdk = package_of("tilburg", "dynamixel_sdk")
        request = sdk.GroupSyncRead(library.dynamixel_portHandler, library.dynamixel_packetHandler, register, size)
        for motor in self._motors:
            request.addParam(motor)
        result = SUCCESS
        for _ in range(TRIES):
            self._begin()
            if (result := request.txRxPacket()) == SUCCESS:
                break
            self._is_late = True
        silent = [
            name
            for name, motor in zip(self._joints, self._motors, strict=True)
            if result != SUCCESS and not request.isAvailable(motor, register, size)
        ]
        if result != SUCCESS or silent:
            why = library.dynamixel_packetHandler.getTxRxResult(result)
            raise DeviceFault(f"no answer from the motors of {', '.join(silent) or 'the hand'}: {why}")
        values = np.array([request.getData(motor, register, size) for motor in self._motors], np.int64)
        return np.where(values >= 1 << (8 * size - 1), values - (1 << 8 * size), values) if size > 1 else values

    def _write_all(self, register: int, size: int, values: Sequence[int]) -> None:
        """Write a register of all motors in one packet, which none answers."""
        library = self._connected()
        sdk = package_of("tilburg", "dynamixel_sdk")
        request = sdk.GroupSyncWrite(library.dynamixel_portHandler, library.dynamixel_packetHandler, register, size)
        for motor, value in zip(self._motors, values, strict=True):
            request.addParam(motor, list(value.to_bytes(size, "little", signed=True)))
        self._begin()
        if (result := request.txPacket()) != SUCCESS:
            raise DeviceFault(library.dynamixel_packetHandler.getTxRxResult(result))

    def _write_each(self, register: int, size: int, value: int, which: NDArray[np.bool_] | None = None) -> None:
        """Write a value to a register of each motor, or of some, and check the answers once all are written.

        Raises:
            DeviceFault: A motor does not answer or refuses; the message names it.
        """
        library = self._connected()
        handler, port = library.dynamixel_packetHandler, library.dynamixel_portHandler
        write = handler.write1ByteTxRx if size == 1 else handler.write2ByteTxRx
        failures: list[str] = []
        for index, (name, motor) in enumerate(zip(self._joints, self._motors, strict=True)):
            if which is not None and not which[index]:
                continue
            result, error = 1, 0
            # To write it twice does no harm; after a motor that does not answer, too much time would pass.
            for _ in range(1 if failures else TRIES):
                self._begin()
                result, error = write(port, motor, register, value)
                error &= ~ALERT
                if result == SUCCESS:
                    break
                self._is_late = True
            if result != SUCCESS or error:
                why = handler.getTxRxResult(result) if result != SUCCESS else handler.getRxPacketError(error)
                failures.append(f"the motor of {name} refuses register {register}: {why}")
        if failures:
            raise DeviceFault("; ".join(failures))

    def _begin(self) -> None:
        """Drop input left by an earlier request, after it has come: the library takes any answer of the right motor."""
        if self._is_late:
            time.sleep(SETTLING)
            self._is_late = False
        try:
            self._connected().dynamixel_portHandler.ser.reset_input_buffer()
        except (OSError, termios.error) as err:  # the latter is no OSError
            raise DeviceFault(f"the port of the hand has disappeared: {err}. Check the USB cable") from err

    def _connected(self) -> Any:
        if self._library is None:
            raise DeviceFault("the hand is not connected")
        return self._library


def _low_latency(set_latency: Any, port: Any, value: bool) -> None:
    try:
        set_latency(port, value)
    except ValueError as err:  # adapters without this setting, and pseudo-terminals
        _log.warning("the port of the hand has no setting for low latency: %s", err)


@contextlib.contextmanager
def _at_home(folder: str) -> Generator[None]:
    """Have the library write its calibration elsewhere than into the user's home."""
    before = os.environ.get("HOME")
    os.environ["HOME"] = folder
    try:
        yield
    finally:
        if before is None:
            del os.environ["HOME"]
        else:
            os.environ["HOME"] = before
