"""The contract of arms on the devices of a lab, at 5 % of their speed.

`rcs.testing` has the whole contract, as tests for who writes a driver; they provoke faults and move at full speed.
These clauses move every joint a little, and the arm holds at the first that is not kept.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rcs.devices import Arm
from rcs.envs.setup import Setup
from rcs.errors import InvalidAction, RcsError
from rcs.hardware.finding import Finding
from rcs.hardware.site import Site
from rcs.setups.resolve import devices_of, resolve

STEP = 0.05
"""By how much each joint moves, towards the middle of its range [rad]."""
SPEED = 0.05
"""Speed of that, as a share of the joints' limits."""
FASTER = 3.0
"""Factor on that speed above which a joint is too fast, measured from one command to the next."""
OFF = 0.01
"""How far from its target a joint may end, and how far one that stands still may move [rad]."""
PERIOD = 1 / 30
"""Time between two commands [s]."""
VALID = 0.25
"""How long a command is valid [s]."""
RESTING = 0.5
"""Time to come to rest, and for which rest is watched [s]."""

Joints = NDArray[np.float64]


class _NotKeptError(Exception):
    """A clause is not kept; the message says how."""


class _Exercise:
    """An open arm that is led to and fro."""

    def __init__(self, arm: Arm) -> None:
        self.arm, limits = arm, arm.limits
        self.start: Joints = np.array(arm.state().joints)
        """Joints before the first command [rad]."""
        middle = (np.array(limits.joint_lower) + np.array(limits.joint_upper)) / 2
        self.goal: Joints = self.start + np.where(self.start < middle, STEP, -STEP)
        self._speed = SPEED * np.array(limits.joint_velocity)
        self._last = self.start

    def lead(self, goal: Joints, share: float = 1.0) -> None:
        """Command the arm along a straight line to joints, or a share of the way."""
        way = goal - self._last
        steps = math.ceil(float((np.abs(way) / self._speed).max()) / PERIOD)
        start, before, at = self._last, np.array(self.arm.state().joints), time.monotonic()
        for step in range(1, math.ceil(share * steps) + 1):
            self._last = start + way * (step / steps)
            self.arm.command_joints(self._last, VALID)
            time.sleep(PERIOD)
            joints, now = np.array(self.arm.state().joints), time.monotonic()
            moved = np.abs(joints - before)
            if (moved > FASTER * self._speed * (now - at) + OFF).any():
                raise _NotKeptError(f"joint {moved.argmax() + 1} moved by {moved.max():.3f} rad in {now - at:.3f} s")
            before, at = joints, now

    def rest(self, where: Joints | None = None) -> None:
        """Check that the arm has come to rest, at joints if they are given."""
        time.sleep(RESTING)
        before = np.array(self.arm.state().joints)
        time.sleep(RESTING)
        off = float(np.abs(self.arm.state().joints - (before if where is None else where)).max())
        if off > OFF:
            raise _NotKeptError(f"it moved by {off:.3f} rad" if where is None else f"it is {off:.3f} rad off")
        if self.arm.fault:
            raise _NotKeptError(self.arm.fault)

    def stopped(self) -> None:
        """Check that the arm has come to rest on its way to the goal, and counts from there."""
        self.rest()
        joints = np.array(self.arm.state().joints)
        if float(np.abs(joints - self.goal).max()) < STEP / 4:
            raise _NotKeptError("it went on to its target")
        if not self.arm.has_arrived():
            raise _NotKeptError("it stands still and does not say so")
        self._last = joints


def _stays(one: _Exercise) -> None:
    one.rest(one.start)


def _refuses(one: _Exercise) -> None:
    is_first = np.arange(one.arm.dof) == 0
    for bad in (*(np.where(is_first, value, one.start) for value in (math.nan, math.inf)), one.start[1:], np.zeros(0)):
        try:
            one.arm.command_joints(bad, VALID)
        except InvalidAction:
            continue
        raise _NotKeptError(f"it takes {np.round(bad, 3)}")
    one.rest(one.start)


def _is_sent_where_it_is(one: _Exercise) -> None:
    one.arm.command_joints(one.start, VALID)
    one.rest(one.start)


def _comes_to_its_target(one: _Exercise) -> None:
    one.lead(one.goal)
    one.rest(one.goal)
    if not one.arm.has_arrived():
        raise _NotKeptError("it is there and does not say so")


def _comes_back(one: _Exercise) -> None:
    one.lead(one.start)
    one.rest(one.start)


def _is_held(one: _Exercise) -> None:
    one.lead(one.goal, 0.5)
    one.arm.hold()
    one.stopped()


def _is_left(one: _Exercise) -> None:
    one.lead(one.goal, 0.5)
    time.sleep(VALID)
    one.stopped()


CLAUSES: Sequence[tuple[str, Callable[[_Exercise], None]]] = (
    ("opening moves nothing", _stays),
    ("a target that makes no sense is refused", _refuses),
    ("a command to where it is moves nothing", _is_sent_where_it_is),
    ("it comes to its target and says so", _comes_to_its_target),
    ("it comes back", _comes_back),
    ("hold stops it on its way", _is_held),
    ("it comes back after that", _comes_back),
    ("a command ends when its time is over", _is_left),
    ("it comes back after that, too", _comes_back),
)
"""Clauses that are checked, in this order."""


def move(site: Site, setup: Setup, may_move: Callable[[str], bool]) -> list[Finding]:
    """Check the clauses of the contract on every arm of a site, one arm after the other, and return findings.

    Args:
        site: The site.
        setup: A setup with its robots.
        may_move: Receives a question; True if the way is free.
    """
    names = ", ".join(site.arms)
    question = (
        f"Move every joint of {names} by {STEP:g} rad to and fro, some times, at {100 * SPEED:g} % of its largest "
        "speed. Is the way free?"
    )
    if not may_move(question):
        message = f"nothing moved, because nobody agreed to this: {question}"
        return [Finding(part="motion", status="warning", message=message, remedy="answer yes")]
    arms = replace(site, cameras={}, tactile={})
    bare = replace(setup, cameras=(), tactile=None)
    try:
        devices = devices_of(arms, resolve(bare))
    except RcsError as err:
        return [Finding(part="motion", status="fault", message=str(err), remedy="see the message; then try again")]
    return [_exercised(name, arm) for name, arm in devices.arms.items()]


def _exercised(name: str, arm: Arm) -> Finding:
    """Open an arm, check the clauses, and close it."""
    clause, trouble = "it opens", list[str]()
    try:
        arm.open()
        one = _Exercise(arm)
        for clause, check in CLAUSES:  # noqa: B007  the one that is not kept is named
            check(one)
    except (_NotKeptError, RcsError) as err:
        trouble = [f"not so at {100 * SPEED:g} % of its speed: {clause}: {err}"]
    for end, call in (("hold", arm.hold if arm.is_open else None), ("close", arm.close)):
        try:
            if call is not None:
                call()
        except RcsError as err:
            trouble.append(f"{end}: {err}")
    if trouble:
        remedy = "look for what blocks it; check its load, calibration, brakes, cable and driver"
        return Finding(part=name, status="fault", message="; ".join(trouble), remedy=remedy)
    message = f"{len(CLAUSES)} clauses of the contract kept; moved by {STEP:g} rad at {100 * SPEED:g} % of its speed"
    return Finding(part=name, status="ok", message=message)
