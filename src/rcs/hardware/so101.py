"""SO101 arms and grippers: six Feetech STS3215 servos on one bus. A leader arm is an arm in guiding mode.

Joints are 0 in the middle of their calibrated range, like LeRobot's in degrees. The calibration is read from LeRobot's
file or from the servos.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from math import tau
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta
from rcs_data.options import Record

from rcs.devices import ArmLimits, ArmState, Gripper, GripperState, StreamedArm, StreamOptions, StreamPoint
from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware.driver import Driver, HostTimes
from rcs.hardware.link import Link
from rcs.hardware.servo_bus import TIMEOUT
from rcs.hardware.so101_servos import (
    ARM,
    GAINS,
    GOAL,
    GRIPPER,
    MARGIN,
    MOST_CURRENT,
    MOST_TORQUE,
    NAMES,
    STEPS,
    TORQUE_LIMIT,
    MotorCalibration,
    Reading,
    Servos,
    read_calibration,
)
from rcs.robots.description import ArmDescription, GripperDescription

RATE = 100.0
"""Rate of setpoints [Hz]; all servos are read before each."""
KEPT_FREE = (MARGIN + 1) * tau / STEPS
"""`MARGIN` as a joint angle, plus rounding [rad]: setpoints come to rest there and are not clipped."""
FRESH = 0.02
"""Largest age of the arm's last reading that the gripper reuses [s]."""
STILL = 20
"""Speed below which the gripper stands still [positions/s]."""
THERE = 40
"""Distance below which the gripper has reached its goal [positions]."""
BEGINNING = 0.2
"""Time until a commanded gripper begins to move [s]."""
GRIP_TORQUE = 500
"""Torque limit of the gripper's servo [1/1000], from LeRobot; the servo burns out if it presses harder for long."""
GRIP_CURRENT = 250
"""Current limit of the gripper's servo [6.5 mA], from LeRobot."""


class So101Options(Record):
    """A site's options for an SO101."""

    calibration: str | Mapping[str, Any] | None = None
    """LeRobot's calibration file for this arm, as a path or its content; None for the calibration in the servos."""
    at_close: Literal["release", "hold"] = "release"
    """When the arm is closed, `release` switches the motors off, so that it falls; `hold` keeps it powered in place."""
    timeout: Annotated[float, Meta(ge=0.01, le=1.0)] = TIMEOUT
    """Time without an answer after which servos count as lost [s]."""

    def motors(self) -> dict[str, MotorCalibration] | None:
        """Return the calibration by motor; None for that in the servos.

        Raises:
            InvalidSetup: The file cannot be read, or is no calibration.
        """
        return None if self.calibration is None else read_calibration(self.calibration)


class So101Arm(StreamedArm):
    """The arm of an SO101, also used as a leader by guiding it. The first command switches the motors on."""

    def __init__(self, link: Link[Servos], limits: ArmLimits, *, options: So101Options, name: str) -> None:
        """Create the arm; `open` connects.

        Args:
            link: Link to its servos.
            limits: Limits of the joints.
            options: The site's options.
            name: Name of the arm in messages.
        """
        silence = options.timeout + 0.2
        super().__init__(
            name,
            limits,
            StreamOptions(rate=RATE, margin=KEPT_FREE, silence=silence, missed_ticks=round(RATE * silence)),
        )
        self.link = link
        self._options = options
        self._calibration = options.motors()
        self._is_powered = self._is_led = self._is_given_way = False
        self._trouble = ""

    def _open(self) -> None:
        self.link.open(self)
        with self.link as servos:
            servos.check(self._calibration, self._options.timeout)
            servos.end_overload(ARM)  # left by an earlier program

    def _close(self) -> None:
        try:
            if self._is_powered and self._options.at_close == "release":
                with self.link as servos:
                    servos.release(ARM)
        except DeviceFault:
            if not self.fault:  # otherwise they are known not to answer
                raise
        finally:
            self._is_powered = self._is_led = self._is_given_way = False
            self.link.close(self)

    def _can_guide(self) -> bool:
        return True

    def _guide(self) -> None:
        with self.link as servos:
            servos.release(ARM)
        self._is_powered = self._is_led = False
        self._is_given_way = True

    def _read(self) -> ArmState:
        with self.link as servos:
            reading, calibrations = servos.read(), servos.calibration
        self._trouble = reading.faults(ARM)
        if self._trouble and not self._is_led and not self.fault:  # otherwise `_write` reports it
            self.set_fault(self._trouble)
        joints = [calibrations[servo].joint(reading.positions[servo]) for servo in ARM]
        signs = [-1.0 if calibrations[servo].drive_mode else 1.0 for servo in ARM]
        speeds = [sign * reading.speeds[servo] * tau / STEPS for sign, servo in zip(signs, ARM, strict=True)]
        return ArmState(joints, speeds, time=reading.time, mode="position" if self._is_powered else "off")

    def _start(self) -> None:
        with self.link as servos:
            if not self._is_given_way:  # a leader is only held
                self._require_range(servos)
            self._is_given_way = False
            servos.tune(ARM)
            self._is_powered = True  # whichever servos are on when one does not answer are released at the end
            servos.power(ARM)
        self._is_led = True

    def _require_range(self, servos: Servos) -> None:
        """Check that the servos can go wherever the limits allow; their own calibration is known only when they answer.

        Raises:
            DeviceFault: The calibrated range of a joint is shorter.
        """
        most = np.maximum(-np.array(self.limits.joint_lower), self.limits.joint_upper)
        for servo, wanted in zip(ARM, most, strict=True):
            half = servos.calibration[servo].half_range
            if half < wanted - tau / STEPS:
                raise DeviceFault(
                    f"{NAMES[servo - 1]} was calibrated for -{half:.3f} to {half:.3f} rad, and the limits allow "
                    f"{wanted:.3f} rad. Give LeRobot's calibration file of this arm in the option `calibration`, from "
                    "which the limits follow."
                )

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
            servos.reconnect()
            over = servos.end_overload(ARM)
            if self._is_powered:
                servos.power(over)
            reading = servos.read()
        if faults := reading.faults(ARM):
            raise DeviceFault(faults)


class So101Gripper(Gripper):
    """The gripper of an SO101. Its servo is limited to half of its torque."""

    def __init__(self, link: Link[Servos], about: GripperDescription, *, options: So101Options, name: str) -> None:
        """Create the gripper; arguments as in `So101Arm`."""
        super().__init__(name, about.max_width, about.max_force)
        self.link = link
        self._options = options
        self._calibration = options.motors()
        self._is_powered = False
        self._goal, self._since = 0, -math.inf

    def _open(self) -> None:
        self.link.open(self)
        with self.link as servos:
            servos.check(self._calibration, self._options.timeout)

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
            servos.put(GRIPPER, TORQUE_LIMIT, torque)
            if not self._is_powered:
                self._is_powered = True
                servos.power([GRIPPER])
            goal = servos.calibration[GRIPPER].position_of_opening(opening)
            if goal != self._goal:
                self._goal, self._since = goal, time.monotonic()
            servos.put(GRIPPER, GOAL, self._goal)

    def _has_arrived(self) -> bool:
        with self.link as servos:
            reading = self._newest(servos)
        is_there = abs(reading.positions[GRIPPER] - self._goal) <= THERE
        # Fingers on an object stand still away from the goal, but only after they have begun to move.
        return abs(reading.speeds[GRIPPER]) < STILL and (is_there or time.monotonic() > self._since + BEGINNING)

    def _hold(self) -> None:
        with self.link as servos:
            # Fingers that press on an object keep pressing: to hold must not mean to drop it.
            reading = servos.read()
            begins = time.monotonic() < self._since + BEGINNING and abs(reading.positions[GRIPPER] - self._goal) > THERE
            if self._is_powered and (abs(reading.speeds[GRIPPER]) >= STILL or begins):
                servos.hold([GRIPPER])
                self._goal, self._since = -1, -math.inf  # treat the next command as new

    def _recover(self) -> None:
        with self.link as servos:
            servos.reconnect()
            over = servos.end_overload([GRIPPER])
            if self._is_powered:
                servos.power(over)
            self._is_powered = self._is_powered and servos.is_on(GRIPPER)  # it is off after a loss of its supply
            if faults := servos.read().faults([GRIPPER]):
                raise DeviceFault(faults)

    def _newest(self, servos: Servos) -> Reading:
        reading = servos.newest(FRESH)
        if faults := reading.faults([GRIPPER]):
            raise DeviceFault(faults)
        return reading


class So101Driver(Driver):
    """Driver of SO101 arms and grippers, with the options of `So101Options`.

    The address is a serial port, or serial number or place of its board.
    """

    hosted = True
    shares_options = True
    host_times = HostTimes(answer=2.0, open=5.0)  # arm and gripper share a line and wait for each other

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> So101Arm:
        """Return the arm at a serial port."""
        if tuple(about.joints) != NAMES[:5]:
            raise InvalidSetup(f"The driver of SO101 arms cannot drive {about.label}.")
        given = So101Options.from_json(options)
        limits = _within(about.arm_limits, given.motors())
        return So101Arm(self._servos(address), limits, options=given, name=address)

    def gripper(self, address: str, about: GripperDescription, options: Mapping[str, Any]) -> So101Gripper:
        """Return the gripper of the arm at a serial port."""
        given = So101Options.from_json(options)
        return So101Gripper(self._servos(address), about, options=given, name=f"{address} gripper")

    def _servos(self, address: str) -> Link[Servos]:
        if not address:
            raise InvalidSetup("The SO101 has no address; give the serial number of its board, or its serial port.")
        return self.link(address, lambda: Servos(address), lambda one: one.bus.close())


def _within(limits: ArmLimits, motors: Mapping[str, MotorCalibration] | None) -> ArmLimits:
    """Return limits of which no joint's range is longer than the one that it was calibrated for."""
    if motors is None:
        return limits
    halves = [motors[name].half_range for name in NAMES[:5]]
    return ArmLimits(
        [max(one, -half) for one, half in zip(limits.joint_lower, halves, strict=True)],
        [min(one, half) for one, half in zip(limits.joint_upper, halves, strict=True)],
        list(limits.joint_velocity),
        joint_acceleration=list(limits.joint_acceleration),
        joint_jerk=list(limits.joint_jerk),
        joint_effort=list(limits.joint_effort),
    )
