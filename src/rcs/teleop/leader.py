"""Leader arms, which a person moves by hand, and how their angles become the joints of the robot that follows.

With torque, motors lead the arm gently after the robot while a person does not lead with it, so that both are at one
place when they begin. Nothing else has the motors on: they go off when the person leads, when news of the robot is
old, when a servo does not answer, and at the end of the program.

For its calibration, a person shows a leader the follower's home, then the direction of each joint and the gripper.
"""

from __future__ import annotations

import atexit
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from math import tau
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from rcs_data.files.durable import write_file
from rcs_data.options import Meta, Record

from rcs.envs.spaces import JOINTS, Observation
from rcs.errors import InvalidSetup, Refused
from rcs.robots.description import ArmDescription
from rcs.teleop.device import Connected, HandReading, Reading

PERIOD = 0.01
"""Time between two readings [s]; a slow bus takes longer."""
LEAST_SPAN = 0.1
"""Smallest way of a gripper's servo from closed to open [rad]."""
FRESH = 0.2
"""Age of the robot's joints from which motors are switched off [s]."""
PACE = 0.5
"""Speed at which a leader follows the robot [rad/s]."""
AHEAD = 0.2
"""Largest way of a motor's goal before its joint [rad]: one that is held is not pulled harder for being far."""

STILL = 0.02
"""Largest motion of a leader that is held still [rad]."""
LOOKS = 20
"""Readings of a leader that is held still."""
TURN = 0.35
"""Way of a joint after which its direction is clear [rad]."""
CLEAR = 3.0
"""A joint is turned by itself if it moves this many times as far as any other."""
PATIENCE = 120.0
"""Time for turning a joint [s]."""


class LeaderBus(Protocol):
    """The servos of a leader, connected; their motors are off."""

    @property
    def failures(self) -> int:
        """Number of questions that had to be repeated."""
        ...

    def angles(self) -> NDArray[np.float64]:
        """Return the servos' angles [rad], (dof + 1,), the gripper's last; whole turns may be missing or too many.

        Raises:
            DeviceFault: A servo does not answer.
        """
        ...

    def drive(self, angles: NDArray[np.float64] | None) -> None:
        """Have motors turn the joints to angles with a small, bounded torque; that of the gripper stays off.

        Args:
            angles: Angles as `angles` has them, without the gripper's [rad], (dof,); None switches the motors off.

        Raises:
            DeviceFault: A servo does not answer, or its motor cannot be bounded.
        """
        ...

    def close(self) -> None:
        """Switch the motors off, and disconnect."""
        ...


class LeaderCalibration(Record):
    """How a leader's angles become the joints of its follower: joint = sign · angle + offset."""

    address: str
    """Serial port."""
    signs: tuple[Literal[-1, 1], ...]
    """Directions of the joints."""
    offsets: tuple[float, ...]
    """Joints at the angle 0 [rad]."""
    near: tuple[float, ...]
    """Joints where the leader was calibrated [rad]: when it is switched on, no joint may be half a turn from there,
    since servos forget whole turns without power."""
    closed: float
    """Angle of the gripper's servo when closed [rad]."""
    opened: float
    """Angle of the gripper's servo when open [rad]."""
    servos: Annotated[tuple[Annotated[int, Meta(ge=0, le=252)], ...], Meta(min_length=2)]
    """Numbers of the servos, the gripper's last."""
    baud: Annotated[int, Meta(ge=9600, le=10_000_000)] = 57600
    """Speed of the serial line [bit/s]."""

    def __post_init__(self) -> None:
        """Check that all numbers fit each other."""
        super().__post_init__()
        dof = len(self.servos) - 1
        if not len(self.signs) == len(self.offsets) == len(self.near) == dof:
            raise InvalidSetup(
                f"The calibration has {len(self.signs)} signs, {len(self.offsets)} offsets and {len(self.near)} values "
                f"of `near`; with {dof + 1} servos, of which one is the gripper's, it must have {dof} of each."
            )
        if len(set(self.servos)) < len(self.servos):
            raise InvalidSetup(f"The servos are {self.servos}; each has a number of its own.")
        if abs(self.opened - self.closed) < LEAST_SPAN:
            raise InvalidSetup(
                f"The gripper is closed at {self.closed} and open at {self.opened} rad; calibrate it anew."
            )

    @staticmethod
    def read(path: Path | str) -> LeaderCalibration:
        """Return the calibration in a file.

        Raises:
            InvalidSetup: The file cannot be read, or is none.
        """
        try:
            values = json.loads(Path(path).expanduser().read_text("utf-8"))
        except (OSError, ValueError, RecursionError) as err:
            raise InvalidSetup(
                f"The leader's calibration {path} cannot be read: {err}. `rcs calibrate leader` writes one."
            ) from err
        return LeaderCalibration.from_json(values)

    def write(self, path: Path) -> None:
        """Write it to a file."""
        write_file(path, (json.dumps(self.to_json(), indent=2) + "\n").encode())

    def joints(self, angles: NDArray[np.float64], near: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the follower's joints [rad], (dof,), with the number of turns that is nearest to some joints.

        Args:
            angles: Angles of all servos [rad], (dof + 1,).
            near: Joints a moment ago [rad], (dof,).
        """
        joints = np.array(self.signs) * angles[:-1] + np.array(self.offsets)
        return joints - tau * np.round((joints - near) / tau)

    def angles(self, joints: NDArray[np.float64], near: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the angles of joints [rad], (dof,), with the number of turns that is nearest to some angles.

        Args:
            joints: Joints of the follower [rad], (dof,).
            near: Present angles of all servos [rad], (dof + 1,).
        """
        angles = np.array(self.signs) * (joints - np.array(self.offsets))
        return angles + tau * np.round((near[:-1] - angles) / tau)

    def opening(self, angles: NDArray[np.float64]) -> float:
        """Return the opening of the gripper, 0 closed … 1 open."""
        way = angles[-1] - self.closed
        way -= tau * round((way - 0.5 * (self.opened - self.closed)) / tau)
        return float(np.clip(way / (self.opened - self.closed), 0.0, 1.0))


class Leader(Connected[LeaderBus]):
    """A leader arm. It leads once it was moved and rests near the follower, without a clutch of its own.

    With torque it rests by itself; it then leads by the clutch of the first device beside it alone.
    """

    valid_for = 0.1
    has_clutch = has_takeover = False

    def __init__(
        self, calibration: LeaderCalibration, connect: Callable[[LeaderCalibration], LeaderBus], *, torque: bool = False
    ) -> None:
        """Remember how to connect.

        Args:
            calibration: Calibration of this leader.
            connect: Connects and switches the motors off; faults as in `InputDevice.open`.
            torque: Have motors lead the arm gently after the robot while the person does not lead.
        """
        super().__init__()
        self.calibration = calibration
        """Calibration in use."""
        self.what = f"leader at {calibration.address}"
        self.has_torque = self.has_clutch = torque
        self.motion = ("joints", len(calibration.near))
        self._make_bus = connect
        self._joints = np.array(calibration.near)
        self._goal: NDArray[np.float64] | None = None
        self._robot: tuple[float, NDArray[np.float64]] | None = None
        self._due = 0.0

    def connect(self) -> LeaderBus:
        """Connect and switch the motors off, so that the leader can be moved."""
        self._joints, self._goal, self._robot = np.array(self.calibration.near), None, None
        bus = self._make_bus(self.calibration)
        atexit.register(self.close)
        return bus

    def measure(self, connection: LeaderBus) -> Reading:
        """Return the joints, a hundred times a second at most; with torque, lead the arm on.

        Raises:
            DeviceFault: A servo does not answer.
        """
        time.sleep(max(self._due - time.monotonic(), 0.0))
        self._due = time.monotonic() + PERIOD
        angles = connection.angles()
        now = time.monotonic()
        self._joints = self.calibration.joints(angles, self._joints)
        if self.has_torque:
            self._goal = self._next_goal(now)
            connection.drive(None if self._goal is None else self.calibration.angles(self._goal, angles))
        hand = HandReading(joints=self._joints, opening=self.calibration.opening(angles))
        return Reading(time=now, hands={"right": hand}, counts={"repeated": connection.failures})

    def feedback(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """With torque, have the arm follow the robot unless the person leads."""
        if self.has_torque:
            hand = self.hands[0]
            own = observation if JOINTS in observation else observation[info["led"][hand]]
            is_led = info["operator"][hand] == "engaged"
            self._robot = None if is_led else (time.monotonic(), np.array(own[JOINTS], np.float64))

    def close(self) -> None:
        """Switch the motors off and disconnect."""
        atexit.unregister(self.close)
        super().close()

    def _next_goal(self, now: float) -> NDArray[np.float64] | None:
        """Return the joints where the motors are to hold the arm next; None for motors that are off."""
        robot = self._robot
        if robot is None or now - robot[0] > FRESH or robot[1].shape != self._joints.shape:
            return None
        start = self._joints if self._goal is None else self._goal
        goal = start + np.clip(robot[1] - start, -PACE * PERIOD, PACE * PERIOD)
        return np.clip(goal, self._joints - AHEAD, self._joints + AHEAD)


def calibrate_leader(
    draft: LeaderCalibration,
    arm: ArmDescription,
    connect: Callable[[LeaderCalibration], LeaderBus],
    *,
    ask: Callable[[str], None],
    show: Callable[[str], None],
) -> LeaderCalibration:
    """Return the calibration that a person shows; nothing moves but what they move.

    Args:
        draft: Address, servos and baud rate; the rest is found.
        arm: The follower.
        connect: Connects and switches the leader's motors off.
        ask: Shows a text and waits until the person confirms.
        show: Shows a text.

    Raises:
        InvalidSetup: The leader has another number of joints than the follower.
        Refused: The leader was not held still, no joint was turned by itself in time, or the gripper did not move.
        DeviceFault: There is no leader, or a servo does not answer.
    """
    if len(draft.servos) != arm.dof + 1:
        raise InvalidSetup(
            f"The leader has the servos {draft.servos}; a leader of {arm.label} has {arm.dof}, and one for the gripper."
        )
    bus = connect(draft)
    try:
        home = ", ".join(f"{name} {np.degrees(joint):.0f}°" for name, joint in zip(arm.joints, arm.home, strict=True))
        ask(f"Hold the leader still in the posture that {arm.label} has at home ({home}), and press Enter.")
        start = _held_still(bus)
        signs: list[int] = []
        for at, name in enumerate(arm.joints):
            show(
                f"{at + 1} of {arm.dof}: turn {name} alone by 30° in the direction in which the robot's joint grows "
                f"(`rcs sim Free --robot {arm.name}` shows it)."
            )
            signs.append(_direction(bus, at, name))
        ask("Close the gripper, and press Enter.")
        closed = float(_held_still(bus)[-1])
        ask("Open the gripper wide, and press Enter.")
        opened = float(_held_still(bus)[-1])
    finally:
        bus.close()
    if abs(opened - closed) < LEAST_SPAN:
        raise Refused(f"The gripper's servo moved by {abs(opened - closed):.3f} rad only; begin again.")
    offsets = np.array(arm.home) - np.array(signs) * start[:-1]
    return replace(
        draft, signs=tuple(signs), offsets=tuple(offsets.tolist()), near=tuple(arm.home), closed=closed, opened=opened
    )


def _held_still(bus: LeaderBus) -> NDArray[np.float64]:
    looks: list[NDArray[np.float64]] = []
    for _ in range(LOOKS):
        looks.append(bus.angles())
        time.sleep(PERIOD)
    moved = np.ptp(looks, axis=0)
    if moved.max() > STILL:
        raise Refused(f"Servo {int(moved.argmax()) + 1} moved by {moved.max():.3f} rad while it was read; begin again.")
    return np.mean(looks, axis=0)


def _direction(bus: LeaderBus, at: int, name: str) -> int:
    """Return the sign of the way that one joint goes alone, the gripper aside."""
    start, end = bus.angles(), time.monotonic() + PATIENCE
    while time.monotonic() < end:
        way = (bus.angles() - start)[:-1]
        others = np.delete(np.abs(way), at)
        if abs(way[at]) > TURN and abs(way[at]) > CLEAR * others.max():
            return 1 if way[at] > 0 else -1
        if others.max() > TURN:
            other = int(np.argmax(np.where(np.arange(len(way)) == at, 0.0, np.abs(way))))
            raise Refused(f"Joint {other + 1} of the leader moved instead of {name}; begin again.")
        time.sleep(PERIOD)
    raise Refused(f"Nobody turned {name} within {PATIENCE:.0f} s; begin again.")
