"""The motion commands of a UR controller, which compute the joints' reference tick by tick.

Each motion advances a `Reference` by `dt` [s]. The laws are simpler than the vendor's, which are not published, but
keep the documented speeds, accelerations and straight lines.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs.errors import RcsError
from rcs.kinematics import IkOptions, IkStatus, Kinematics
from rcs.spatial import Pose

Vector = NDArray[np.float64]

_ONE_BRANCH = IkOptions(translation_tolerance=1e-6, rotation_tolerance=1e-6, restarts=0)


class ProgramError(RcsError):
    """An error that ends a program on the controller, such as a pose out of reach."""


@dataclass
class Reference:
    """The servos' reference: joint positions [rad], velocities [rad/s] and accelerations [rad/s²]."""

    joints: Vector
    velocities: Vector = field(default_factory=lambda: np.zeros(6))
    accelerations: Vector = field(default_factory=lambda: np.zeros(6))

    def coast(self, velocities: Vector, dt: float) -> None:
        """Move at velocities for a tick."""
        self.accelerations = (velocities - self.velocities) / dt
        self.velocities = velocities
        self.joints = self.joints + velocities * dt

    def rest(self) -> None:
        """Stand still."""
        self.velocities = self.accelerations = np.zeros(6)


class Motion(Protocol):
    """A motion that moves a reference."""

    def step(self, reference: Reference, dt: float) -> bool:
        """Move the reference by one tick of `dt` [s] and return True if the motion is over."""
        ...


class Chain:
    """The arm's kinematics with a tool: poses of the TCP in the base, in the controller's format."""

    def __init__(self, kinematics: Kinematics, tcp_in_flange: Pose) -> None:
        """Combine the kinematics of the flange with a TCP."""
        self._kinematics = kinematics
        self.tcp_in_flange = tcp_in_flange

    def forward(self, joints: Vector) -> Pose:
        """Return the pose of the TCP."""
        return self._kinematics.forward(joints) * self.tcp_in_flange

    def inverse(self, pose: Pose, near: Vector) -> Vector:
        """Return joint positions [rad] for a pose of the TCP, on the solution branch of `near`.

        Raises:
            ProgramError: There is no solution.
        """
        found = self._kinematics.inverse(pose * self.tcp_in_flange.inverse(), near, _ONE_BRANCH)
        if found.status != IkStatus.ok:
            raise ProgramError(f"get_inverse_kin: no solution for {np.round(vector_of(pose), 4).tolist()}")
        return found.joints

    def velocities(self, joints: Vector, twist: Vector) -> Vector:
        """Return joint velocities [rad/s] for a twist of the TCP in the base [m/s, rad/s]."""
        lever = self.forward(joints).translation - self._kinematics.forward(joints).translation
        at_flange = np.concatenate([twist[:3] - np.cross(twist[3:], lever), twist[3:]])
        return self._kinematics.velocities(joints, at_flange).joints


def pose_of(vector: ArrayLike) -> Pose:
    """Return a pose from the controller's six numbers: position [m] and rotation vector [rad]."""
    values = np.asarray(vector, np.float64)
    return Pose.from_rotvec(values[:3], values[3:6])


def vector_of(pose: Pose) -> Vector:
    """Return the controller's six numbers for a pose."""
    return np.concatenate([pose.translation, pose.rotvec])


@dataclass
class Servo:
    """servoj and servol: joints follow a target, and lag `lookahead` seconds behind a moving one.

    The acceleration is `gain` times the error, projected by the present velocity over `lookahead`. With
    gain >= 4 / lookahead², it does not overshoot.
    """

    target: Vector
    lookahead: float
    gain: float

    def step(self, reference: Reference, dt: float) -> bool:
        """Move by one tick."""
        error = self.target - reference.joints - self.lookahead * reference.velocities
        reference.coast(reference.velocities + self.gain * dt * error, dt)
        return False


@dataclass
class SpeedJoints:
    """speedj: joint velocities, reached at an acceleration [rad/s²] of the leading axis."""

    velocities: Vector
    acceleration: float

    def step(self, reference: Reference, dt: float) -> bool:
        """Move by one tick."""
        reference.coast(_towards(reference.velocities, self.velocities, self.acceleration * dt), dt)
        return False


@dataclass
class SpeedTcp:
    """speedl: a twist of the TCP [m/s, rad/s], reached at an acceleration [m/s², rad/s²]."""

    twist: Vector
    acceleration: float
    chain: Chain
    present: Vector = field(default_factory=lambda: np.zeros(6))

    def step(self, reference: Reference, dt: float) -> bool:
        """Move by one tick."""
        self.present = _towards(self.present, self.twist, self.acceleration * dt)
        reference.coast(self.chain.velocities(reference.joints, self.present), dt)
        return False


@dataclass
class Stop:
    """stopj, stopl, servo and speed stops: brake along the joints' present direction, with a deceleration [rad/s²]."""

    deceleration: float

    def step(self, reference: Reference, dt: float) -> bool:
        """Move by one tick."""
        reference.coast(_towards(reference.velocities, np.zeros(6), self.deceleration * dt), dt)
        return not reference.velocities.any()


def _towards(present: Vector, target: Vector, most: float) -> Vector:
    """Return velocities on the straight line from present to target, at most `most` further in the leading axis."""
    gap = target - present
    largest = float(np.abs(gap).max())
    return target if largest <= most else present + gap * (most / largest)
