"""A GELLO: a small copy of an arm with Dynamixel servos, built for the robot that follows it."""

from __future__ import annotations

from rcs.errors import InvalidSetup
from rcs.teleop.dynamixel import DynamixelBus
from rcs.teleop.leader import Leader, LeaderCalibration


def gello(address: str | None = None, *, torque: bool = False) -> Leader:
    """Return the leader with the calibration in a file.

    Args:
        address: Path of a file that `rcs calibrate leader` has written; it has the serial port.
        torque: Have motors lead the arm gently after the robot while the person does not lead; see `Leader`.

    Raises:
        InvalidSetup: There is no such file.
    """
    if not address or not address.endswith(".json"):
        raise InvalidSetup(
            f"A GELLO needs the file of its calibration, such as gello:gello.json, not {address!r}; "
            "`rcs calibrate leader` writes it."
        )
    return Leader(LeaderCalibration.read(address), connect, torque=torque)


def connect(calibration: LeaderCalibration) -> DynamixelBus:
    """Connect the servos of a calibration; faults as in `DynamixelBus`."""
    return DynamixelBus(calibration.address, calibration.servos, calibration.baud)
