"""The messages on the ports of an xArm controller: requests, answers and reports, with their codes.

A request consists of a header of u16 number, u16 protocol and u16 length in network order, a function, and its values
with little-endian floats. The answer repeats header and function, and has a state byte before its values. The layout is
that of the vendor's manual.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rcs.spatial import Pose
from rcs.virtual.virtual_robot import VirtualRobot

COMMAND_PORT, NORMAL_PORT, RICH_PORT, REAL_PORT = 502, 30001, 30002, 30003
REPORT_RATES: Final = {NORMAL_PORT: 5, RICH_PORT: 5, REAL_PORT: 100}
"""Reports per second of each port [Hz]."""
MODEL: Final = 7
"""Model number of the xArm7."""
HAS_ERROR, HAS_WARNING, NOT_READY, REFUSED = 0x40, 0x20, 0x10, 0x08
"""Bits of the state byte."""
NO_SUCH_FUNCTION: Final = 13
"""Warning about an unknown function."""

Vector = NDArray[np.float64]


class State(enum.IntEnum):
    """States of the controller; vendor's manual."""

    MOVING = 1
    READY = 2
    PAUSED = 3
    STOPPED = 4
    CHANGED = 5
    """A mode or a setting was changed: nothing moves until the state is set to 0."""


class Mode(enum.IntEnum):
    """Modes that this controller supports."""

    POSITION = 0
    SERVO = 1
    MANUAL = 2


class Code(enum.IntEnum):
    """Errors of the controller that end a motion; vendor's manual."""

    BUTTON = 1
    SERVOS = 10
    JOINT_1 = 11
    KINEMATICS = 21
    RANGE = 23
    JOINT_SPEED = 24
    COLLISION = 31
    TCP_SPEED = 60


class Request(NamedTuple):
    """A request of a client."""

    number: int
    protocol: int
    function: int
    values: bytes


def requests(received: bytearray) -> Iterator[Request]:
    """Yield all complete requests in a client's bytes and remove them; heartbeats are dropped."""
    while len(received) >= 6:
        number, protocol, size = struct.unpack_from(">3H", received)
        if len(received) < 6 + size:
            return
        body = bytes(received[6 : 6 + size])
        del received[: 6 + size]
        if size and body != b"\0\0":
            yield Request(number, protocol, body[0], body[1:])


def answer_packet(request: Request, answer: bytes) -> bytes:
    """Return the packet that answers a request with a state byte and values."""
    return struct.pack(">3HB", request.number, request.protocol, 1 + len(answer), request.function) + answer


def floats(values: Sequence[float] | Vector) -> bytes:
    """Return numbers as little-endian floats of four bytes each."""
    return np.asarray(values, "<f4").tobytes()


def pose_of(values: bytes) -> Pose:
    """Return the pose encoded in six floats: translation [mm], and roll, pitch, yaw [rad]."""
    given = np.array(struct.unpack_from("<6f", values), np.float64)
    return Pose.from_xyzrpy(np.concatenate([1e-3 * given[:3], given[3:]]))


def pose_values(pose: Pose) -> Vector:
    """Return a pose in the controller's format, shape (6,): translation [mm], and roll, pitch, yaw [rad]."""
    given = pose.xyzrpy
    return np.concatenate([1e3 * given[:3], given[3:]])


def report(
    port: int,
    robot: VirtualRobot,
    *,
    state: State,
    mode: Mode,
    pose: Vector,
    enabled: int,
    error: int,
    warning: int,
    tool: Vector,
    load: Sequence[float],
    sensitivity: int,
    version: str,
) -> bytes:
    """Return a report, preceded by its size.

    Args:
        port: Port of the report, which determines its fields; `RICH_PORT` has most.
        robot: The arm, for its joints, velocities and torques.
        state: State of the controller.
        mode: Mode of the controller.
        pose: Pose of the TCP, as `pose_values` returns it.
        enabled: Bits of the joints whose motors have power.
        error: Code of the error; 0 for none.
        warning: Code of the warning; 0 for none.
        tool: Pose of the TCP in the flange, as `pose_values` returns it.
        load: Mass [kg] and centre of mass [mm] of the load at the flange.
        sensitivity: Sensitivity to collisions, 0 to 5.
        version: Version of the firmware.
    """
    joints, about = robot.joints, robot.about
    body = bytes([state | mode << 4]) + bytes(2) + floats(joints) + floats(pose) + floats(robot.torques)
    if port != REAL_PORT:
        brakes = 0x7F if enabled else 0  # 1 is released
        body += bytes([brakes, enabled, error, warning]) + floats(tool) + floats(load)
        body += bytes([sensitivity, 3]) + floats([0.0, 0.0, -1.0])  # 3: sensitivity of guiding by hand
    if port == RICH_PORT:
        body += bytes([MODEL, 7, 0xAA, 0x55, 0, 0]) + f"v{version}".encode().ljust(30, b"\0")
        body += floats([1e4, 0.1, 5e4, 0.1, 1e3])  # of the TCP: jerk, accelerations, speeds [mm]
        body += floats([about.jerk_limit[0], 0.01, about.acceleration_limit[0], 1e-4, np.pi])  # of joints
        body += floats([2.3, 2.7])  # of rotation: jerk, acceleration
        codes = [1 if error == Code.JOINT_1 + joint else 0 for joint in range(7)]
        body += bytes(byte for code in codes for byte in (2 if code else 0, code)) + bytes(2)
        body += bytes([35] * 7)  # temperatures
        body += floats([0.0]) + floats(robot.velocities) + struct.pack(">I", 0)
    return struct.pack(">I", 4 + len(body)) + body
