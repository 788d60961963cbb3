"""Calibration of a leader: a person shows it the follower's home, then the direction of each joint and the gripper."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rcs.errors import InvalidSetup, Refused
from rcs.robots.description import ArmDescription
from rcs.teleop.leader import LEAST_SPAN, LeaderBus, LeaderCalibration

STILL = 0.02
"""Largest motion of a leader that is held still [rad]."""
LOOKS = 20
"""Readings of a leader that is held still."""
TURN = 0.35
"""Way of a joint after which its direction is clear [rad]."""
CLEAR = 3.0
"""A joint is turned by itself if it moves this many times as far as any other."""
PERIOD = 0.01
"""Time between two readings [s]."""
PATIENCE = 120.0
"""Time for turning a joint [s]."""


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
