"""The six Feetech STS3215 servos of an SO101: registers, calibration and measurements."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import tau
from pathlib import Path
from typing import Any

from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware.servo_bus import ServoBus, signed

NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
"""LeRobot's names of the servos 1 to 6."""
ARM, GRIPPER = (1, 2, 3, 4, 5), 6
STEPS = 4096
"""Encoder positions per turn."""
STS3215 = 777
"""Model number that the servos report."""
MARGIN = 4
"""Margin at the ends of the calibrated range that commands never enter [positions]."""
OPENING = 1.0
"""Timeout for the servos' answers while connecting [s]."""
RECOVERY = 0.3
"""Time for which a servo may still report an overload after it is switched off [s]."""
JUMP = 0.15
"""Distance beyond a joint's fastest possible motion from which its reading is repeated [rad]."""
FASTEST = 10.0
"""Largest speed of a joint that a person moves [rad/s]."""

# First byte and size of registers, from Feetech's table of the STS series.
MODEL, OFFSET, LOWEST, HIGHEST = (3, 2), (31, 2), (9, 2), (11, 2)
MOST_TORQUE, GAIN_P, GAIN_D, GAIN_I, MOST_CURRENT = (16, 2), (21, 1), (22, 1), (23, 1), (28, 2)
TORQUE_ON, ACCELERATION, GOAL, TORQUE_LIMIT, LOCK = (40, 1), (41, 1), (42, 2), (48, 2), (55, 1)
SETTINGS = 40
"""Number of registers in permanent memory, from 0."""
PRESENT, PRESENT_SIZE = 56, 15
"""First register and size of the measurements: position, speed, load, voltage, temperature, …, errors, …, current."""

GAINS = {GAIN_P: 16, GAIN_I: 0, GAIN_D: 32}
"""Gains from LeRobot (so_follower); with the factory's gains the arm shakes."""

ERRORS = {1: "undervoltage", 2: "angle sensor", 4: "overheating", 8: "overcurrent", 32: "overload"}
"""Errors in each answer of a servo, by bit."""
_OVERLOAD, _VOLTAGE = 32, 1
_ADVICE = {
    "undervoltage": "look at the power supply",
    "angle sensor": "replace the servo",
    "overheating": "let it cool down",
    "overcurrent": "check what blocks the joint",
    "overload": "check what blocks the joint, then recover",
}


@dataclass(frozen=True, kw_only=True)
class MotorCalibration:
    """The calibration of one motor, with the fields of LeRobot's file."""

    id: int
    """Number of the servo."""
    drive_mode: int
    """1 if the motor turns the other way."""
    homing_offset: int
    """Encoder position that counts as 0."""
    range_min: int
    """Lowest position of the joint."""
    range_max: int
    """Highest position of the joint."""

    @property
    def half_range(self) -> float:
        """Angle from the middle of the range to either end [rad]."""
        return 0.5 * (self.range_max - self.range_min) * tau / STEPS

    def joint(self, position: float) -> float:
        """Return the joint position [rad] for a position of the servo."""
        way = (position - 0.5 * (self.range_min + self.range_max)) * tau / STEPS
        return -way if self.drive_mode else way

    def position(self, joint: float) -> int:
        """Return the position of the servo for a joint position [rad], clipped to the range."""
        way = (-joint if self.drive_mode else joint) * STEPS / tau
        return self._within(0.5 * (self.range_min + self.range_max) + way)

    def opening(self, position: float) -> float:
        """Return the opening of the gripper at a position of its servo, 0 closed … 1 open."""
        part = (position - self.range_min) / (self.range_max - self.range_min)
        return 1.0 - part if self.drive_mode else part

    def position_of_opening(self, opening: float) -> int:
        """Return the position of the gripper's servo for an opening."""
        part = 1.0 - opening if self.drive_mode else opening
        return self._within(self.range_min + part * (self.range_max - self.range_min))

    def _within(self, position: float) -> int:
        return min(max(round(position), self.range_min + MARGIN), self.range_max - MARGIN)


@dataclass(frozen=True, kw_only=True)
class Reading:
    """The measurements of all servos at one time."""

    time: float
    """Time on the monotonic clock [s]."""
    positions: Mapping[int, int]
    """Positions by servo."""
    speeds: Mapping[int, int]
    """Speeds by servo [positions/s]."""
    errors: Mapping[int, int]
    """Error bits by servo."""
    volts: Mapping[int, float]
    """Voltages by servo [V]."""

    def faults(self, servos: Sequence[int]) -> str:
        """Return a description of the servos' faults by joint; empty without a fault."""
        found: list[str] = []
        for bit, what in ERRORS.items():
            names = [NAMES[servo - 1] for servo in servos if self.errors[servo] & bit]
            if names:
                volts = f" ({min(self.volts[servo] for servo in servos):.1f} V)" if bit == _VOLTAGE else ""
                found.append(f"{what} at {', '.join(names)}{volts}: {_ADVICE[what]}")
        return "; ".join(found)


class Servos:
    """The six servos of one SO101, connected."""

    def __init__(self, address: str) -> None:
        """Open the bus; nothing is sent.

        Args:
            address: Path of the serial port, or serial number or place of the board.

        Raises:
            DeviceFault: The port cannot be used.
            InvalidSetup: There is none with this serial number or place.
            MissingDependency: The vendor's library is not installed.
        """
        self.bus = ServoBus(address, dict(enumerate(NAMES, 1)), OPENING)
        self.last: Reading | None = None
        """The newest reading."""
        self.calibration: Mapping[int, MotorCalibration] = {}
        """Calibration by servo; empty before `check`."""
        self._given: Mapping[str, MotorCalibration] | None = None
        self._timeout = 0.0
        self.bus.open()

    def check(self, calibration: Mapping[str, MotorCalibration] | None, timeout: float) -> None:
        """Check that it is the expected arm, without switching a motor on or off.

        Args:
            calibration: Calibration that the servos must have, by motor; None to accept theirs.
            timeout: Time without an answer after which servos count as lost from now on [s]; the longest one given
                counts, as devices share the bus.

        Raises:
            DeviceFault: A servo does not answer, or its model or calibration is not the expected one.
        """
        longest = max(self._timeout, timeout)
        try:
            if calibration is not None or not self.calibration:
                self.bus.timeout = max(longest, OPENING)
                self.calibration = self._found(calibration)
                self._given = calibration
            self._timeout = longest
        finally:
            self.bus.timeout = self._timeout or OPENING

    def read(self) -> Reading:
        """Read all servos at once.

        Raises:
            DeviceFault: A servo does not answer.
        """
        reading = self._read()
        if self.last is not None and _has_jumped(self.last, reading):
            reading = self._read()  # it moved that far, or the checksum matched by chance
        self.last = reading
        return reading

    def reconnect(self) -> None:
        """Open a port that has disappeared again, and check that the same arm is there.

        Raises:
            DeviceFault: The port is not there, or another arm is.
        """
        self.bus.mute_until = 0.0
        if not self.bus.is_gone:
            return
        self.bus.close()
        self.bus.open()
        try:
            self.calibration = self._found(self._given)
        except DeviceFault:
            self.bus.is_gone = True
            raise
        self.last = None

    def newest(self, age: float) -> Reading:
        """Return the last reading if it is not older than `age` [s], else a new one."""
        last = self.last
        return last if last is not None and time.monotonic() - last.time < age else self.read()

    def set(self, servo: int, register: tuple[int, int], value: int) -> None:
        """Write a register; one in permanent memory, which wears, only if its value differs."""
        first, size = register
        if first < SETTINGS:
            _, values = self.bus.read([servo], first, size)[servo]
            if int.from_bytes(values, "little") == value:
                return
            self.bus.write(servo, LOCK[0], 0, 1)
        self.bus.write(servo, first, value, size)
        if first < SETTINGS:
            self.bus.write(servo, LOCK[0], 1, 1)

    def put(self, servo: int, register: tuple[int, int], value: int) -> None:
        """Write a register in volatile memory."""
        first, size = register
        self.bus.write(servo, first, value, size)

    def tune(self, servos: Sequence[int]) -> None:
        """Set the gains of servos and switch off their own velocity ramps."""
        first = GAIN_P[0]
        gains = bytes(GAINS[register, 1] for register in range(first, first + len(GAINS)))
        for servo, (_, values) in self.bus.read(servos, first, ACCELERATION[0] + 1 - first).items():
            if values[: len(gains)] != gains:
                self.bus.write(servo, LOCK[0], 0, 1)
                self.bus.write(servo, first, int.from_bytes(gains, "little"), len(gains))
                self.bus.write(servo, LOCK[0], 1, 1)
            if values[-1]:
                self.bus.write(servo, ACCELERATION[0], 0, 1)

    def hold(self, servos: Sequence[int]) -> None:
        """Hold servos at their present positions."""
        reading = self.read()
        self.bus.write_all(GOAL[0], {servo: _goal(reading.positions[servo]) for servo in servos})

    def power(self, servos: Sequence[int]) -> None:
        """Switch servos on at their positions: set the goal before the torque, or they would jump to an old goal."""
        positions = self.read().positions
        for servo in servos:
            self.put(servo, GOAL, _goal(positions[servo]))
            self.put(servo, TORQUE_ON, 1)

    def is_on(self, servo: int) -> bool:
        """Return whether a servo's motor is switched on."""
        _, values = self.bus.read([servo], *TORQUE_ON)[servo]
        return bool(values[0])

    def end_overload(self, servos: Sequence[int]) -> list[int]:
        """Switch off servos in overload, which clears it, and return them."""
        errors = self.read().errors
        over = [servo for servo in servos if errors[servo] & _OVERLOAD]
        self.release(over)
        end = time.monotonic() + RECOVERY
        while any(self.read().errors[servo] & _OVERLOAD for servo in over) and time.monotonic() < end:
            time.sleep(5e-3)
        return over

    def release(self, servos: Sequence[int]) -> None:
        """Switch servos off; an arm without support falls.

        Raises:
            DeviceFault: A servo does not answer; all others are off.
        """
        failures: list[DeviceFault] = []
        for servo in servos:
            try:
                self.put(servo, TORQUE_ON, 0)
            except DeviceFault as err:
                failures.append(err)
        if failures:
            raise failures[0]

    def _read(self) -> Reading:
        servos = range(1, len(NAMES) + 1)
        found = self.bus.read(list(servos), PRESENT, PRESENT_SIZE)
        now = time.monotonic()
        words = {servo: values for servo, (_, values) in found.items()}
        return Reading(
            time=now,
            positions={servo: signed(int.from_bytes(own[:2], "little"), 15) for servo, own in words.items()},
            speeds={servo: signed(int.from_bytes(own[2:4], "little"), 15) for servo, own in words.items()},
            errors={servo: errors for servo, (errors, _) in found.items()},
            volts={servo: own[6] / 10 for servo, own in words.items()},
        )

    def _found(self, wanted: Mapping[str, MotorCalibration] | None) -> dict[int, MotorCalibration]:
        """Return the calibration of the servos after comparing it with a given one."""
        found = self.bus.read(list(range(1, len(NAMES) + 1)), 0, SETTINGS)
        calibration: dict[int, MotorCalibration] = {}
        amiss: list[str] = []
        for servo, (_, own) in found.items():
            name = NAMES[servo - 1]
            if (model := _number(own, MODEL)) != STS3215:
                amiss.append(f"{name} has the model number {model}, the driver needs {STS3215} (STS3215)")
                continue
            values = {
                "homing_offset": signed(_number(own, OFFSET), 11),
                "range_min": _number(own, LOWEST),
                "range_max": _number(own, HIGHEST),
            }
            given = None if wanted is None else wanted[name]
            if given is not None and (wrong := [key for key in values if getattr(given, key) != values[key]]):
                amiss += [f"{name} has the {key} {values[key]}, the file {getattr(given, key)}" for key in wrong]
            if values["range_max"] - values["range_min"] < 10 * MARGIN:
                amiss.append(f"{name} has the range {values['range_min']} to {values['range_max']}")
            elif (values["range_min"], values["range_max"]) == (0, STEPS - 1) and name != "wrist_roll":
                amiss.append(f"{name} has not been calibrated")
            calibration[servo] = MotorCalibration(
                id=servo, drive_mode=0 if given is None else given.drive_mode, **values
            )
        if amiss:
            raise DeviceFault(
                f"The arm at {self.bus.address} is not the expected one: {'; '.join(amiss)}. Give the calibration "
                "file of this arm, or calibrate it: lerobot-calibrate."
            )
        return calibration


def read_calibration(given: str | Path | Mapping[str, Any]) -> dict[str, MotorCalibration]:
    """Return the calibration by motor from LeRobot's file, given by its path or content.

    Raises:
        InvalidSetup: The file cannot be read, or a motor or value is missing or invalid.
    """
    content: Any = given
    if isinstance(given, str | Path):
        try:
            content = json.loads(Path(given).expanduser().read_text("utf-8"))
        except (OSError, ValueError, RecursionError) as err:
            raise InvalidSetup(f"The calibration {given} cannot be read: {err}.") from err
    if not isinstance(content, Mapping):
        raise InvalidSetup(f"The calibration is {content!r}; valid is the path of LeRobot's file, or its content.")
    try:
        found = {name: MotorCalibration(**content[name]) for name in NAMES}
    except (TypeError, KeyError) as err:
        fields = ", ".join(MotorCalibration.__dataclass_fields__)
        raise InvalidSetup(
            f"The calibration lacks {err} or has extra fields; valid is, for each of {', '.join(NAMES)}: {fields}."
        ) from err
    for servo, (name, motor) in enumerate(found.items(), 1):
        values = vars(motor)
        if not all(isinstance(value, int) for value in values.values()) or motor.id != servo:
            raise InvalidSetup(f"The calibration of {name} is {values}; valid are whole numbers, and the id {servo}.")
    return found


def _has_jumped(before: Reading, now: Reading) -> bool:
    most = (JUMP + FASTEST * (now.time - before.time)) * STEPS / tau
    return any(abs(now.positions[servo] - before.positions[servo]) > most for servo in now.positions)


def _number(values: bytes, register: tuple[int, int]) -> int:
    first, size = register
    return int.from_bytes(values[first : first + size], "little")


def _goal(position: int) -> int:
    return min(max(position, 0), STEPS - 1)
