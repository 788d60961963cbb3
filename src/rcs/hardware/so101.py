"""SO101 arms and their grippers: six Feetech STS3215 on one bus; a leader arm is one that is guided.

Joints are 0 in the middle of their calibrated range, as LeRobot's are in degrees. The calibration is that of the file
which LeRobot has written, or of the servos themselves.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import tau
from pathlib import Path
from typing import Any, Literal

from rcs.devices import ArmLimits, ArmState, Gripper, GripperState, StreamedArm, StreamOptions, StreamPoint
from rcs.errors import DeviceFault, InvalidSetup, require_fields
from rcs.hardware.driver import Driver, HostTimes
from rcs.hardware.fake import limits_of
from rcs.hardware.link import Link
from rcs.hardware.servo_bus import TIMEOUT, ServoBus, signed
from rcs.robots.description import ArmDescription, GripperDescription

NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
"""The servos 1 to 6, as LeRobot calls them."""
ARM, GRIPPER = (1, 2, 3, 4, 5), 6
STEPS = 4096
"""Positions of the encoder in a turn."""
STS3215 = 777
"""Number of the model, as the servos tell it."""
RATE = 100.0
"""Points per second; all servos are read before each [Hz]."""
MARGIN = 4
"""Positions at the ends of the calibrated range to which nothing is led."""
KEPT_FREE = (MARGIN + 1) * tau / STEPS
"""The same for joints [rad], with what rounding takes: points come to rest there and are not cut off."""
FRESH = 0.02
"""The gripper is shown as the arm's last read has it when that is not older than this [s]."""
LONGEST_TIMEOUT = 1.0
"""Longest time for which servos may not answer, as an option [s]."""
OPENING = 1.0
"""How long servos may take to answer when they are connected [s]."""
RECOVERY = 0.3
"""How long a servo may still tell an overload when it has been switched off [s]."""
STILL = 20
"""A gripper that is slower than this stands still [positions/s]."""
THERE = 40
"""A gripper that is nearer to its goal than this has reached it [positions]."""
BEGINNING = 0.2
"""How long it takes a gripper to begin to move [s]."""
JUMP = 0.15
"""A joint that is farther than this from where its fastest motion may have brought it is read once more [rad]."""
FASTEST = 10.0
"""Speed of a joint that a person swings [rad/s]."""

# First byte and size of registers, from Feetech's table of the STS series.
MODEL, OFFSET, LOWEST, HIGHEST = (3, 2), (31, 2), (9, 2), (11, 2)
MOST_TORQUE, GAIN_P, GAIN_D, GAIN_I, MOST_CURRENT = (16, 2), (21, 1), (22, 1), (23, 1), (28, 2)
TORQUE_ON, ACCELERATION, GOAL, TORQUE_LIMIT, LOCK = (40, 1), (41, 1), (42, 2), (48, 2), (55, 1)
SETTINGS = 40
"""Number of registers that last without power, from 0."""
PRESENT, PRESENT_SIZE = 56, 15
"""What servos measure: position, speed, load, voltage, temperature, …, errors, …, current."""

GAINS = {GAIN_P: 16, GAIN_I: 0, GAIN_D: 32}
"""LeRobot's (so_follower): with the factory's the arm shakes."""
GRIP_TORQUE = 500
"""Largest torque of the gripper's servo [1/1000], LeRobot's: it burns out where it presses with more for long."""
GRIP_CURRENT = 250
"""Largest current of the gripper's servo [6.5 mA], LeRobot's."""

ERRORS = {1: "undervoltage", 2: "angle sensor", 4: "overheating", 8: "overcurrent", 32: "overload"}
"""What servos tell in each answer, by bit."""
_OVERLOAD, _VOLTAGE = 32, 1
_ADVICE = {
    "undervoltage": "look at the power supply",
    "angle sensor": "replace the servo",
    "overheating": "let it cool down",
    "overcurrent": "see what blocks the joint",
    "overload": "see what blocks the joint, then recover",
}


@dataclass(frozen=True, kw_only=True)
class MotorCalibration:
    """The calibration of one motor, with the fields of LeRobot's file."""

    id: int
    """Number of the servo."""
    drive_mode: int
    """1 where the motor turns the other way."""
    homing_offset: int
    """Position of the encoder that counts as 0."""
    range_min: int
    """Lowest position of the joint."""
    range_max: int
    """Highest position of the joint."""

    def joint(self, position: float) -> float:
        """Return the joint at a position of the servo [rad]."""
        way = (position - 0.5 * (self.range_min + self.range_max)) * tau / STEPS
        return -way if self.drive_mode else way

    def position(self, joint: float) -> int:
        """Return the position of the servo for a joint [rad], within the range."""
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
class So101Options:
    """What a site may say of an SO101."""

    calibration: str | Mapping[str, Any] | None = None
    """Path of the file that LeRobot has written for this arm, or what is in it; None for that which the servos have."""
    at_close: Literal["release", "hold"] = "release"
    """Whether the motors are switched off when the arm is closed, so that it falls, or it keeps its place and power."""
    timeout: float = TIMEOUT
    """How long servos may not answer before they count as lost [s], 0.01 to 1."""

    @staticmethod
    def of(options: Mapping[str, Any]) -> So101Options:
        """Return the options of a site.

        Raises:
            InvalidSetup: One is unknown, or has a value that makes no sense.
        """
        require_fields("option of an SO101", options, So101Options.__dataclass_fields__)
        given = So101Options(**options)
        if given.at_close not in ("hold", "release"):
            raise InvalidSetup(f"at_close is {given.at_close!r}; valid: 'hold', 'release'.")
        timeout: Any = given.timeout
        if isinstance(timeout, bool) or not isinstance(timeout, int | float) or not 0.01 <= timeout <= LONGEST_TIMEOUT:
            raise InvalidSetup(f"timeout is {timeout!r} s; valid is 0.01 to {LONGEST_TIMEOUT:g} s.")
        return given


@dataclass(frozen=True, kw_only=True)
class Reading:
    """What all servos measured at one time."""

    time: float
    """When, on the monotonic clock [s]."""
    positions: Mapping[int, int]
    """By servo."""
    speeds: Mapping[int, int]
    """By servo, in positions per second."""
    errors: Mapping[int, int]
    """Bits by servo."""
    volts: Mapping[int, float]
    """By servo."""

    def faults(self, servos: Sequence[int]) -> str:
        """Return what is wrong with servos, by joint; empty if nothing is."""
        told: list[str] = []
        for bit, what in ERRORS.items():
            names = [NAMES[servo - 1] for servo in servos if self.errors[servo] & bit]
            if names:
                volts = f" ({min(self.volts[servo] for servo in servos):.1f} V)" if bit == _VOLTAGE else ""
                told.append(f"{what} at {', '.join(names)}{volts}: {_ADVICE[what]}")
        return "; ".join(told)


class Servos:
    """The six servos of one SO101, connected."""

    def __init__(self, address: str, calibration: Mapping[str, MotorCalibration] | None, timeout: float) -> None:
        """Open the bus, and check that it is the arm that is meant; no motor is switched on or off.

        Args:
            address: Path of the serial port.
            calibration: What the servos must have, by motor; None to take what they have.
            timeout: How long servos may not answer before they count as lost [s].

        Raises:
            DeviceFault: A servo does not answer, is of another model, or has no calibration or another one.
            MissingDependency: The vendor's library is not installed.
        """
        self.bus = ServoBus(address, dict(enumerate(NAMES, 1)), max(timeout, OPENING))
        self.last: Reading | None = None
        """The newest reading."""
        self._given = calibration
        self.bus.open()
        try:
            self.calibration = self._check()
            """By servo."""
        except BaseException:
            self.bus.close()
            raise
        self.bus.timeout = timeout

    def read(self) -> Reading:
        """Read all servos at once.

        Raises:
            DeviceFault: A servo does not answer.
        """
        reading = self._read()
        if self.last is not None and _has_jumped(self.last, reading):
            reading = self._read()  # it has come that far, or its checksum was right by chance
        self.last = reading
        return reading

    def newest(self, age: float) -> Reading:
        """Return the last reading if it is not older than this [s], else a new one."""
        last = self.last
        return last if last is not None and time.monotonic() - last.time < age else self.read()

    def set(self, servo: int, register: tuple[int, int], value: int) -> None:
        """Write a register; one that lasts without power only if it differs, since that memory wears."""
        first, size = register
        if first < SETTINGS:
            _, values = self.bus.read([servo], first, size)[servo]
            if int.from_bytes(values, "little") == value:
                return
            self.bus.write(servo, LOCK[0], 0, 1)
        self.bus.write(servo, first, value, size)
        if first < SETTINGS:
            self.bus.write(servo, LOCK[0], 1, 1)

    def tune(self, servos: Sequence[int]) -> None:
        """Give servos their gains, and have them go to goals without ramps of their own."""
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
        """Have servos stay where they are."""
        reading = self.read()
        self.bus.write_all(GOAL[0], {servo: _goal(reading.positions[servo]) for servo in servos})

    def power(self, servos: Sequence[int]) -> None:
        """Switch servos on where they are: first their goal, then the torque, or they would jump to an old one."""
        positions = self.read().positions
        for servo in servos:
            self.bus.write(servo, *_with(GOAL, _goal(positions[servo])))
            self.bus.write(servo, *_with(TORQUE_ON, 1))

    def end_overload(self, servos: Sequence[int]) -> list[int]:
        """Switch off those servos that are in overload, which ends it, and return them."""
        over = [servo for servo in servos if self.read().errors[servo] & _OVERLOAD]
        self.release(over)
        end = time.monotonic() + RECOVERY
        while any(self.read().errors[servo] & _OVERLOAD for servo in over) and time.monotonic() < end:
            time.sleep(5e-3)
        return over

    def release(self, servos: Sequence[int]) -> None:
        """Switch servos off; an arm that nobody holds falls."""
        for servo in servos:
            self.bus.write(servo, *_with(TORQUE_ON, 0))

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

    def _check(self) -> dict[int, MotorCalibration]:
        """Return the calibration of the servos, which must be the one that was given."""
        found = self.bus.read(list(range(1, len(NAMES) + 1)), 0, SETTINGS)
        calibration: dict[int, MotorCalibration] = {}
        amiss: list[str] = []
        for servo, (_, own) in found.items():
            name = NAMES[servo - 1]
            if (model := _number(own, MODEL)) != STS3215:
                amiss.append(f"{name} is of the model {model}, this driver speaks with {STS3215} (STS3215)")
                continue
            values = {
                "homing_offset": signed(_number(own, OFFSET), 11),
                "range_min": _number(own, LOWEST),
                "range_max": _number(own, HIGHEST),
            }
            given = None if self._given is None else self._given[name]
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
                f"The arm at {self.bus.address} is not the one that is meant: {'; '.join(amiss)}. Give the calibration "
                "file of this arm, or calibrate it: lerobot-calibrate."
            )
        return calibration


class So101Arm(StreamedArm):
    """The arm of an SO101; guided, it is a leader. No motor is switched on before the first command."""

    def __init__(self, link: Link[Servos], limits: ArmLimits, *, options: So101Options, name: str) -> None:
        """Describe the arm; nothing is connected.

        Args:
            link: Its servos.
            limits: Its limits.
            options: What else the site says.
            name: Name in messages.
        """
        silence = options.timeout + 0.2
        super().__init__(
            name,
            limits,
            StreamOptions(rate=RATE, margin=KEPT_FREE, silence=silence, missed_ticks=round(RATE * silence)),
        )
        self.link = link
        self._options = options
        self._is_powered = self._is_led = False
        self._trouble = ""

    def _open(self) -> None:
        self.link.open(self)
        with self.link as servos:
            servos.end_overload(ARM)  # of one that was left so

    def _close(self) -> None:
        try:
            if self._is_powered and self._options.at_close == "release":
                with self.link as servos:
                    servos.release(ARM)
        except DeviceFault:
            if not self.fault:  # else it is known that they do not answer
                raise
        finally:
            self._is_powered = self._is_led = False
            self.link.close(self)

    def _can_guide(self) -> bool:
        return True

    def _guide(self) -> None:
        with self.link as servos:
            servos.release(ARM)
        self._is_powered = self._is_led = False

    def _read(self) -> ArmState:
        with self.link as servos:
            reading, calibrations = servos.read(), servos.calibration
        self._trouble = reading.faults(ARM)
        if self._trouble and not self._is_led and not self.fault:  # else `_write` tells
            self.set_fault(self._trouble)
        joints = [calibrations[servo].joint(reading.positions[servo]) for servo in ARM]
        signs = [-1.0 if calibrations[servo].drive_mode else 1.0 for servo in ARM]
        speeds = [sign * reading.speeds[servo] * tau / STEPS for sign, servo in zip(signs, ARM, strict=True)]
        return ArmState(joints, speeds, time=reading.time, mode="position" if self._is_powered else "off")

    def _start(self) -> None:
        with self.link as servos:
            servos.tune(ARM)
            servos.power(ARM)
        self._is_powered = self._is_led = True

    def _write(self, point: StreamPoint) -> None:
        if self._trouble:
            raise DeviceFault(self._trouble)
        with self.link as servos:
            goals = {servo: servos.calibration[servo].position(q) for servo, q in zip(ARM, point.position, strict=True)}
            servos.bus.write_all(GOAL[0], goals)

    def _stop(self) -> None:
        self._is_led = False
        if self._is_powered:
            with self.link as servos:
                servos.hold(ARM)

    def _clear(self) -> None:
        with self.link as servos:
            over = servos.end_overload(ARM)
            if self._is_powered:
                servos.power(over)
            reading = servos.read()
        if told := reading.faults(ARM):
            raise DeviceFault(told)


class So101Gripper(Gripper):
    """The gripper of an SO101, whose servo never has more than half of its torque."""

    def __init__(self, link: Link[Servos], about: GripperDescription, *, options: So101Options, name: str) -> None:
        """Describe the gripper; arguments as those of the arm."""
        super().__init__(name, about.max_width, about.max_force)
        self.link = link
        self._options = options
        self._is_powered = False
        self._goal, self._since = 0, -math.inf

    def _open(self) -> None:
        self.link.open(self)

    def _close(self) -> None:
        try:
            if self._is_powered and self._options.at_close == "release":
                with self.link as servos:
                    servos.release([GRIPPER])
        except DeviceFault:
            if not self.fault:
                raise
        finally:
            self._is_powered = False
            self.link.close(self)

    def _state(self) -> GripperState:
        with self.link as servos:
            reading = self._newest(servos)
            opening = servos.calibration[GRIPPER].opening(reading.positions[GRIPPER])
        return GripperState(min(max(opening, 0.0), 1.0), time=reading.time)

    def _command_opening(self, opening: float, force: float | None) -> None:
        torque = round(GRIP_TORQUE * (1.0 if force is None else force / self.max_force))
        with self.link as servos:
            self._newest(servos)
            if not self._is_powered:
                for register, value in {**GAINS, MOST_TORQUE: GRIP_TORQUE, MOST_CURRENT: GRIP_CURRENT}.items():
                    servos.set(GRIPPER, register, value)
            servos.bus.write(GRIPPER, *_with(TORQUE_LIMIT, torque))
            if not self._is_powered:
                servos.power([GRIPPER])
                self._is_powered = True
            self._goal, self._since = servos.calibration[GRIPPER].position_of_opening(opening), time.monotonic()
            servos.bus.write(GRIPPER, *_with(GOAL, self._goal))

    def _has_arrived(self) -> bool:
        with self.link as servos:
            reading = self._newest(servos)
        is_there = abs(reading.positions[GRIPPER] - self._goal) <= THERE
        # Fingers that something is between stand still elsewhere, but not before they have begun to move.
        return abs(reading.speeds[GRIPPER]) < STILL and (is_there or time.monotonic() > self._since + BEGINNING)

    def _hold(self) -> None:
        with self.link as servos:
            # Fingers that press on an object go on pressing: letting it fall is not holding.
            if abs(servos.read().speeds[GRIPPER]) >= STILL and self._is_powered:
                servos.hold([GRIPPER])

    def _recover(self) -> None:
        with self.link as servos:
            over = servos.end_overload([GRIPPER])
            if self._is_powered:
                servos.power(over)
            if told := servos.read().faults([GRIPPER]):
                raise DeviceFault(told)

    def _newest(self, servos: Servos) -> Reading:
        reading = servos.newest(FRESH)
        if told := reading.faults([GRIPPER]):
            raise DeviceFault(told)
        return reading


class So101Driver(Driver):
    """Makes SO101 arms and their grippers, at a serial port; options are those of `So101Options`."""

    hosted = True
    host_times = HostTimes(answer=2.0, open=5.0)  # arm and gripper wait for each other: one line for both

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> So101Arm:
        """Return an arm, at the path of its serial port."""
        if tuple(about.joints) != NAMES[:5]:
            raise InvalidSetup(f"The driver of SO101 arms cannot drive {about.label}.")
        given = So101Options.of(options)
        return So101Arm(self._servos(address, given), limits_of(about), options=given, name=address)

    def gripper(self, address: str, about: GripperDescription, options: Mapping[str, Any]) -> So101Gripper:
        """Return a gripper, at the path of the serial port of its arm."""
        given = So101Options.of(options)
        return So101Gripper(self._servos(address, given), about, options=given, name=f"{address} gripper")

    def _servos(self, address: str, options: So101Options) -> Link[Servos]:
        if not address:
            raise InvalidSetup("An SO101 has no address; give the path of its serial port, such as /dev/ttyACM0.")
        calibration = None if options.calibration is None else read_calibration(options.calibration)
        return self.link(address, lambda: Servos(address, calibration, options.timeout), lambda one: one.bus.close())


def read_calibration(given: str | Path | Mapping[str, Any]) -> dict[str, MotorCalibration]:
    """Return the calibration by motor from the path of LeRobot's file, or from what is in it.

    Raises:
        InvalidSetup: It cannot be read, or a motor or a value is missing or none.
    """
    content: Any = given
    if isinstance(given, str | Path):
        try:
            content = json.loads(Path(given).expanduser().read_text("utf-8"))
        except (OSError, ValueError, RecursionError) as err:
            raise InvalidSetup(f"The calibration {given} cannot be read: {err}.") from err
    try:
        found = {name: MotorCalibration(**content[name]) for name in NAMES}
    except (TypeError, KeyError) as err:
        fields = ", ".join(MotorCalibration.__dataclass_fields__)
        raise InvalidSetup(
            f"The calibration lacks {err} or has too much; valid is, for each of {', '.join(NAMES)}: {fields}."
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


def _with(register: tuple[int, int], value: int) -> tuple[int, int, int]:
    return register[0], value, register[1]


def _goal(position: int) -> int:
    return min(max(position, 0), STEPS - 1)
