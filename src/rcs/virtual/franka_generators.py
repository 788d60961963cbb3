"""A Franka controller's interpretation of the commands of each millisecond, and its checks.

The checks are the necessary conditions of the vendor's "Control Interface Specification and Robot Limits"; a client
that violates one is stopped. Clients compute from states in `float32` and apply a low-pass, so commands within their
own limits have slightly larger accelerations and jerks here; `TOLERANCE` and `JERK_TOLERANCE` allow for that.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rcs.hardware.franka_limits import velocity_bounds
from rcs.kinematics import Kinematics
from rcs.robots.description import ArmDescription
from rcs.spatial import Pose
from rcs.virtual.franka_messages import Error, GeneratorMode

PERIOD: Final = 1e-3
"""Time between commands [s]."""
TOLERANCE: Final = 1.05
JERK_TOLERANCE: Final = 1.5
START_TOLERANCE: Final = 1e-3
"""Largest distance between the start of a motion and the last commanded position [rad, m]."""
TORQUE_RATE: Final = 1000.0
"""Limit of the torque rate [N·m/s]; libfranka, rate_limiting.h."""
CARTESIAN_LIMITS: Final = ((3.0, 9.0, 4500.0), (2.5, 17.0, 8500.0))
"""Limits of the TCP: translation [m/s, m/s², m/s³] and rotation [rad/s, rad/s², rad/s³]; rate_limiting.h."""

_JOINT_ERRORS = (
    Error.JOINT_MOTION_GENERATOR_POSITION_LIMITS_VIOLATION,
    Error.JOINT_MOTION_GENERATOR_VELOCITY_LIMITS_VIOLATION,
    Error.JOINT_MOTION_GENERATOR_VELOCITY_DISCONTINUITY,
    Error.JOINT_MOTION_GENERATOR_ACCELERATION_DISCONTINUITY,
)
_INVERSE_ERRORS = (
    Error.CARTESIAN_MOTION_GENERATOR_JOINT_POSITION_LIMITS_VIOLATION,
    Error.CARTESIAN_MOTION_GENERATOR_JOINT_VELOCITY_LIMITS_VIOLATION,
    Error.CARTESIAN_MOTION_GENERATOR_JOINT_VELOCITY_DISCONTINUITY,
    Error.CARTESIAN_MOTION_GENERATOR_JOINT_ACCELERATION_DISCONTINUITY,
)
_CARTESIAN_ERRORS = (
    Error.CARTESIAN_MOTION_GENERATOR_VELOCITY_LIMITS_VIOLATION,
    Error.CARTESIAN_MOTION_GENERATOR_VELOCITY_DISCONTINUITY,
    Error.CARTESIAN_MOTION_GENERATOR_ACCELERATION_DISCONTINUITY,
)

Vector = NDArray[np.float64]


class MotionGenerator:
    """Computes the commanded joints from a client's positions or velocities of the joints or the TCP.

    Attributes:
        joints: Commanded joint positions [rad], shape (7,).
        velocities: Commanded joint velocities [rad/s], shape (7,).
        accelerations: Commanded joint accelerations [rad/s²], shape (7,).
        pose: Commanded pose of the TCP in the base.
    """

    def __init__(self, mode: GeneratorMode, arm: ArmDescription, kinematics: Kinematics, joints: Vector) -> None:
        """Start at rest at the last commanded joint positions [rad], shape (7,)."""
        self.mode = mode
        self.joints = joints.copy()
        self.velocities, self.accelerations = np.zeros(7), np.zeros(7)
        self.pose = kinematics.forward(self.joints)
        self._twist, self._twist_change = np.zeros(6), np.zeros(6)
        self._arm, self._kinematics = arm, kinematics
        self._has_begun = False
        self._taken = (self.joints, self.velocities, self.accelerations, self.pose)  # at the last command

    def take(self, command: Any, ticks: int = 1) -> list[Error]:
        """Follow a command and return its errors; if there are any, the caller must stop the arm.

        Args:
            command: An `ARM_COMMAND`.
            ticks: Number of milliseconds since the last command. During those without a command, the arm is assumed to
                have continued at the same acceleration.
        """
        self.joints, self.velocities, self.accelerations, self.pose = self._taken
        for _ in range(ticks - 1):
            self.extrapolate()
        errors = self._take(command)
        self._taken = (self.joints, self.velocities, self.accelerations, self.pose)
        return errors

    def _take(self, command: Any) -> list[Error]:
        errors: list[Error] = []
        if self.mode is GeneratorMode.JOINT_POSITION:
            joints = np.array(command["q_c"])
            if not self._has_begun and np.abs(joints - self.joints).max() > START_TOLERANCE:
                return [Error.JOINT_POSITION_MOTION_GENERATOR_START_POSE_INVALID]
            velocities = (joints - self.joints) / PERIOD
        elif self.mode is GeneratorMode.JOINT_VELOCITY:
            velocities = np.array(command["dq_c"])
            joints = self.joints + velocities * PERIOD
        else:
            if self.mode is GeneratorMode.CARTESIAN_POSITION:
                matrix = np.array(command["O_T_EE_c"]).reshape(4, 4).T
                if not _is_rigid(matrix):
                    return [Error.CARTESIAN_POSITION_MOTION_GENERATOR_INVALID_FRAME]
                pose = Pose.from_matrix(matrix)
                way = _difference(pose, self.pose)
                if not self._has_begun and np.abs(way).max() > START_TOLERANCE:
                    return [Error.CARTESIAN_POSITION_MOTION_GENERATOR_START_POSE_INVALID]
                twist = way / PERIOD
            else:
                twist = np.array(command["O_dP_EE_c"])
                if not np.isfinite(twist).all():
                    return [Error.CARTESIAN_MOTION_GENERATOR_VELOCITY_LIMITS_VIOLATION]
                turn = Pose.from_rotvec((0.0, 0.0, 0.0), twist[3:] * PERIOD) * Pose((0, 0, 0), self.pose.quaternion)
                pose = Pose(self.pose.translation + twist[:3] * PERIOD, turn.quaternion)
            errors += self._check_twist(twist)
            self.pose = pose
            joints = self._inverse(float(command["elbow_c"][0]) if command["valid_elbow"] else None)
            velocities = (joints - self.joints) / PERIOD
        self._has_begun = True
        errors += self._check_joints(joints, velocities)
        self.accelerations = (velocities - self.velocities) / PERIOD
        self.joints, self.velocities = joints, velocities
        return errors

    def extrapolate(self) -> None:
        """Continue for a millisecond without a command at the same joint acceleration."""
        if not self._has_begun:
            return
        self.velocities = self.velocities + self.accelerations * PERIOD
        self.joints = self.joints + self.velocities * PERIOD
        self.pose = self._kinematics.forward(self.joints)

    def _inverse(self, elbow: float | None) -> Vector:
        """Return joint positions [rad], shape (7,), for the pose near the last; the third joint stays unless given."""
        jacobian = np.vstack([self._kinematics.jacobian(self.joints), np.eye(7)[2]])
        way = _difference(self.pose, self._kinematics.forward(self.joints))
        turn = 0.0 if elbow is None else elbow - self.joints[2]
        square = jacobian @ jacobian.T + 1e-10 * np.eye(7)
        return self.joints + jacobian.T @ np.linalg.solve(square, np.append(way, turn))

    def _check_joints(self, joints: Vector, velocities: Vector) -> list[Error]:
        accelerations = (velocities - self.velocities) / PERIOD
        jerks = (accelerations - self.accelerations) / PERIOD
        slowest, fastest = velocity_bounds(self._arm, self.joints)
        broken = (
            ~((joints >= self._arm.joint_lower) & (joints <= self._arm.joint_upper)),  # NaN, too
            (velocities < TOLERANCE * slowest - 1e-3) | (velocities > TOLERANCE * fastest + 1e-3),
            np.abs(accelerations) > TOLERANCE * np.array(self._arm.acceleration_limit),
            np.abs(jerks) > JERK_TOLERANCE * np.array(self._arm.jerk_limit),
        )
        names = (
            _JOINT_ERRORS
            if self.mode in (GeneratorMode.JOINT_POSITION, GeneratorMode.JOINT_VELOCITY)
            else _INVERSE_ERRORS
        )
        return [name for name, where in zip(names, broken, strict=True) if where.any()]

    def _check_twist(self, twist: Vector) -> list[Error]:
        change = (twist - self._twist) / PERIOD
        jerk = (change - self._twist_change) / PERIOD
        self._twist, self._twist_change = twist, change
        errors: set[Error] = set()
        for part, limits in zip((slice(0, 3), slice(3, 6)), CARTESIAN_LIMITS, strict=True):
            tolerances = (TOLERANCE, TOLERANCE, JERK_TOLERANCE)
            for name, value, limit, tolerance in zip(
                _CARTESIAN_ERRORS, (twist, change, jerk), limits, tolerances, strict=True
            ):
                if np.linalg.norm(value[part]) > tolerance * limit:
                    errors.add(name)
        return sorted(errors)


def torque_errors(arm: ArmDescription, torques: Vector, before: Vector, ticks: int) -> list[Error]:
    """Return the errors of commanded torques [N·m], shape (7,), sent `ticks` after the torques `before`."""
    errors: list[Error] = []
    if np.abs(torques - before).max() > TOLERANCE * TORQUE_RATE * PERIOD * ticks:
        errors.append(Error.CONTROLLER_TORQUE_DISCONTINUITY)
    if (np.abs(torques) > TOLERANCE * np.array(arm.effort_limit)).any():
        errors.append(Error.TAU_J_RANGE_VIOLATION)
    return errors


def motion_errors(arm: ArmDescription, joints: Vector, velocities: Vector) -> list[Error]:
    """Return the errors of measured joint positions [rad] and velocities [rad/s], shape (7,) each."""
    errors: list[Error] = []
    if (joints < arm.joint_lower).any() or (joints > arm.joint_upper).any():
        errors.append(Error.JOINT_POSITION_LIMITS_VIOLATION)
    slowest, fastest = velocity_bounds(arm, joints)
    if (velocities < TOLERANCE * slowest - 0.05).any() or (velocities > TOLERANCE * fastest + 0.05).any():
        errors.append(Error.JOINT_VELOCITY_VIOLATION)
    return errors


def _difference(goal: Pose, start: Pose) -> Vector:
    """Return the difference of two poses as translation [m] and rotation vector [rad] in the base, shape (6,)."""
    return np.concatenate([goal.translation - start.translation, (goal * start.inverse()).rotvec])


def _is_rigid(matrix: NDArray[np.float64]) -> bool:
    turn = matrix[:3, :3]
    return bool(np.isfinite(matrix).all() and np.abs(turn @ turn.T - np.eye(3)).max() < 1e-4)
