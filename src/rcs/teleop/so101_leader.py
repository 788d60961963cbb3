"""The leader of an SO101: six Feetech servos on a serial port."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware.servo_bus import TIMEOUT
from rcs.hardware.so101_servos import ARM, GOAL, GRIPPER, MOST_TORQUE, TORQUE_LIMIT, TORQUE_ON, Servos
from rcs.teleop.leader import Leader, LeaderCalibration

SERVOS = (*ARM, GRIPPER)
GENTLE = 150
"""Largest torque of a motor [1/1000 of its stall torque, about 3 N·m at 12 V and 2 N·m at 7.4 V]."""


class So101Bus:
    """The servos of an SO101 leader, calibrated by LeRobot."""

    def __init__(self, calibration: LeaderCalibration) -> None:
        """Connect and switch the motors off.

        Args:
            calibration: Its address is used.

        Raises:
            DeviceFault: There is no bus, or a servo does not answer or is not calibrated.
            MissingDependency: The vendor's library is not installed.
        """
        self._servos = Servos(calibration.address)
        self._usual: dict[int, int] = {}  # torque limits before the first drive, by servo
        self._is_on = False
        try:
            self._servos.check(None, TIMEOUT)
            self._servos.release(SERVOS)
        except BaseException:
            self.close()
            raise

    @property
    def failures(self) -> int:
        """Number of questions that had to be repeated."""
        return self._servos.bus.failures

    def angles(self) -> NDArray[np.float64]:
        """Return the joints [rad], 0 in the middle of their range, and the opening of the gripper, (6,)."""
        positions, calibration = self._servos.read().positions, self._servos.calibration
        joints = [calibration[servo].joint(positions[servo]) for servo in ARM]
        return np.array([*joints, calibration[GRIPPER].opening(positions[GRIPPER])])

    def drive(self, angles: NDArray[np.float64] | None) -> None:
        """Have motors turn the joints to angles [rad], (5,), with at most `GENTLE`; None switches them off.

        Raises:
            DeviceFault: A servo does not answer.
        """
        servos = self._servos
        if angles is None:
            if self._is_on:
                servos.release(ARM)
                self._is_on = False
            return
        if not self._usual:
            found = servos.bus.read(ARM, *MOST_TORQUE)
            self._usual = {servo: int.from_bytes(values, "little") for servo, (_, values) in found.items()}
        goals = {at: servos.calibration[at].position(float(angle)) for at, angle in zip(ARM, angles, strict=True)}
        if not self._is_on:
            for servo in ARM:  # acknowledged, so that no motor is on without its limit
                servos.bus.write(servo, TORQUE_LIMIT[0], GENTLE, TORQUE_LIMIT[1])
        servos.bus.write_all(GOAL[0], goals, GOAL[1])
        if not self._is_on:
            self._is_on = True
            servos.bus.write_all(TORQUE_ON[0], dict.fromkeys(ARM, 1), TORQUE_ON[1])

    def close(self) -> None:
        """Switch the motors off, give them their usual limits, and disconnect."""
        bus = self._servos.bus
        try:
            if self._usual and bus.is_open:
                for _ in range(5):  # nobody acknowledges it
                    bus.write_all(TORQUE_ON[0], dict.fromkeys(ARM, 0), TORQUE_ON[1])
                bus.write_all(TORQUE_LIMIT[0], self._usual, TORQUE_LIMIT[1])
        except DeviceFault:
            return  # it is unplugged
        finally:
            bus.close()


def so101_leader(address: str | None = None, *, torque: bool = False) -> Leader:
    """Return the leader at a serial port, or with the calibration in a file.

    Args:
        address: Serial port such as `/dev/ttyACM1`, for a leader whose joints are those of the follower, as LeRobot
            calibrates it; or the path of a file that `rcs calibrate leader` has written.
        torque: Have motors lead the arm gently after the robot while the person does not lead; see `Leader`.

    Raises:
        InvalidSetup: There is no address, or the file is no calibration of six servos.
    """
    if not address:
        raise InvalidSetup(
            "The leader has no address, and its board looks like that of a follower; give its serial port, such as "
            "so101_leader:/dev/ttyACM1, or the file of its calibration."
        )
    calibration = LeaderCalibration.read(address) if address.endswith(".json") else uncalibrated(address)
    if calibration.servos != SERVOS:
        raise InvalidSetup(f"The calibration {address} is for the servos {calibration.servos}, not for an SO101.")
    return Leader(calibration, So101Bus, torque=torque)


def uncalibrated(address: str, servos: tuple[int, ...] = SERVOS) -> LeaderCalibration:
    """Return the calibration of a leader whose joints are those of the follower.

    Args:
        address: Its serial port.
        servos: Numbers of its servos, the gripper's last.
    """
    zeros = (0.0,) * (len(servos) - 1)
    return LeaderCalibration(
        address=address, signs=(1,) * len(zeros), offsets=zeros, near=zeros, closed=0.0, opened=1.0, servos=servos
    )
