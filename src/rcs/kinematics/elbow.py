"""The elbow of an arm with seven joints: its angle, and motions that keep the TCP in place.

Such an arm reaches a pose in infinitely many ways; its elbow turns about the line from shoulder to wrist. The angle of
the plane of shoulder, elbow and wrist distinguishes them: Kreutz-Delgado, Long and Seraji, "Kinematic analysis of 7-DOF
manipulators", 1992.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs._core import IkOptions, IkResult, IkStatus, Kinematics
from rcs.errors import InvalidSetup
from rcs.spatial import Pose

JOINTS = 7
STRIDE = 0.05
"""Change of the fastest joint between two corrections of the TCP [rad]: 1 mm off for an arm of 1 m."""
STRIDES = 400
"""Largest number of strides of a call: a joint may turn by 20 rad."""
NEAR = 1e-4
"""Tolerance of a wanted angle [rad]."""
EXACT = IkOptions(restarts=0, translation_tolerance=1e-7, rotation_tolerance=1e-7, iterations=20)
"""Solver options that bring the TCP back after a stride."""


class Elbow:
    """Finds and moves the elbow of an arm with seven joints, at poses of the TCP that stay as they are."""

    def __init__(self, kinematics: Kinematics) -> None:
        """Use the kinematics of an arm.

        Args:
            kinematics: Kinematics of an arm whose first three joints turn its shoulder, the fourth its elbow and the
                last three its wrist.

        Raises:
            InvalidSetup: The arm does not have seven joints.
        """
        if kinematics.dof != JOINTS:
            raise InvalidSetup(
                f"The arm has {kinematics.dof} joints; only with {JOINTS} the elbow moves while the TCP stays."
            )
        self._kinematics = kinematics
        self._lower, self._upper = kinematics.joint_lower, kinematics.joint_upper

    def angle(self, joints: ArrayLike) -> float:
        """Return the angle of the elbow [rad], -π … π.

        It is 0 above the line from shoulder to wrist, and grows by the right-hand rule about that line. An arm that is
        stretched, or whose wrist is right above its shoulder, has none: the number is then any.

        Args:
            joints: Joint positions [rad], shape (7,).
        """
        return _angle(*self._points(np.asarray(joints, np.float64)))

    def move(self, joints: ArrayLike, by: float) -> IkResult:
        """Turn the elbow by an angle.

        Args:
            joints: Joint positions [rad], shape (7,), inside the limits.
            by: The change of the angle [rad], of any sign; more than 2 π goes round.

        Returns:
            Joints with the same pose of the TCP. `ok` if the elbow got there; `clamped` if a joint's limit, or a
            posture from which it cannot go on, has stopped it on its way. The errors are of the TCP's pose.
        """
        q = np.array(joints, np.float64)
        pose = self._kinematics.forward(q)
        turned, iterations = 0.0, 0
        here = self.angle(q)
        while abs(by - turned) > NEAR and iterations < STRIDES:
            iterations += 1
            found = self._stride(q, here, pose, by - turned)
            if found is None:
                break
            q, there = found
            turned += _wrapped(there - here)
            here = there
        status = IkStatus.ok if abs(by - turned) <= NEAR else IkStatus.clamped
        miss = self._kinematics.forward(q)
        return IkResult(q.tolist(), status, miss.distance_to(pose), miss.angle_to(pose), iterations)

    def to(self, joints: ArrayLike, angle: float) -> IkResult:
        """Turn the elbow to an angle, the shorter way round; returns what `move` does.

        Args:
            joints: Joint positions [rad], shape (7,), inside the limits.
            angle: The wanted angle [rad].
        """
        return self.move(joints, _wrapped(angle - self.angle(joints)))

    def inverse(self, target: Pose, start: ArrayLike, angle: float, options: IkOptions | None = None) -> IkResult:
        """Return joints for a pose of the TCP with the elbow at an angle, or as near to it as it gets from there.

        Args:
            target: TCP pose in the base frame.
            start: Joints to look from [rad], shape (7,).
            angle: The wanted angle of the elbow [rad].
            options: Solver options for the pose.

        Returns:
            `ok`: the pose and the angle are met; `clamped`: the pose alone. Otherwise what the solver has found.
        """
        found = self._kinematics.inverse(target, np.asarray(start, np.float64), options or IkOptions())
        if found.status != IkStatus.ok:
            return found
        turned = self.to(found.joints, angle)
        miss = self._kinematics.forward(turned.joints)
        iterations = found.iterations + turned.iterations
        return IkResult(
            turned.joints.tolist(), turned.status, miss.distance_to(target), miss.angle_to(target), iterations
        )

    def _stride(
        self, q: NDArray[np.float64], here: float, pose: Pose, left: float
    ) -> tuple[NDArray[np.float64], float] | None:
        """Return joints nearer to the wanted angle, and their angle; None if there are none."""
        way = self.direction(q) * np.sign(left)
        blocked = ((q <= self._lower + 1e-9) & (way < -1e-9)) | ((q >= self._upper - 1e-9) & (way > 1e-9))
        if blocked.any():
            return None
        size = STRIDE / float(np.abs(way).max())
        room = np.where(way < 0, self._lower - q, self._upper - q) / np.where(way == 0, 1e-300, way)
        size = min(size, float(room[np.abs(way) > 1e-9].min()))
        for _ in range(6):
            back = self._kinematics.inverse(pose, np.clip(q + size * way, self._lower, self._upper), EXACT)
            there = self.angle(back.joints)
            gained = _wrapped(there - here) * np.sign(left)
            if back.status == IkStatus.ok and 0.0 < gained <= abs(left) + NEAR:
                return back.joints, there
            size *= 0.5 if gained <= 0.0 or back.status != IkStatus.ok else abs(left) / gained
        return None

    def direction(self, joints: ArrayLike) -> NDArray[np.float64]:
        """Return the motion of the joints that moves the elbow to greater angles and leaves the TCP where it is.

        It has length 1 and shape (7,).

        Args:
            joints: Joint positions [rad], shape (7,).
        """
        q = np.asarray(joints, np.float64)
        way = np.linalg.svd(self._kinematics.jacobian(q))[2][-1]
        gained = _wrapped(self.angle(q + 1e-5 * way) - self.angle(q - 1e-5 * way))
        return way if gained >= 0.0 else -way

    def _points(self, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """Return shoulder, elbow and wrist in the base frame [m].

        They are on the axes of joints 2, 4 and 6, where these are nearest to the joints before them.
        """
        jacobian = self._kinematics.jacobian(q)
        tcp = self._kinematics.forward(q).translation
        axes = jacobian[3:].T
        on_axes = tcp - np.cross(jacobian[:3].T, axes)  # the feet of perpendiculars from the TCP
        shoulder = _nearest_to_line(on_axes[1], axes[1], on_axes[0], axes[0])
        elbow = on_axes[3] + axes[3] * ((shoulder - on_axes[3]) @ axes[3])
        wrist = on_axes[5] + axes[5] * ((elbow - on_axes[5]) @ axes[5])
        return shoulder, elbow, wrist


def _nearest_to_line(
    point: NDArray[np.float64], axis: NDArray[np.float64], other: NDArray[np.float64], direction: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the point of a line that is nearest to another line, both given by a point and a direction of length 1."""
    cosine = float(axis @ direction)
    between = other - point
    return point + axis * ((between @ axis - cosine * (between @ direction)) / max(1.0 - cosine**2, 1e-12))


def _angle(shoulder: NDArray[np.float64], elbow: NDArray[np.float64], wrist: NDArray[np.float64]) -> float:
    line = (wrist - shoulder) / max(float(np.linalg.norm(wrist - shoulder)), 1e-12)
    up = np.array([0.0, 0.0, 1.0])
    above, side = up - line * (up @ line), elbow - shoulder
    return float(np.arctan2(line @ np.cross(above, side), above @ (side - line * (side @ line))))


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
