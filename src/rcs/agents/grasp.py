"""Where to grasp: plans that scripted experts share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rcs.kinematics import DampedLeastSquares, IkOptions, IkStatus
from rcs.spatial import Pose


@dataclass(frozen=True, kw_only=True)
class GraspPlan:
    """A grasp that the arm can reach, with what leads there."""

    tcp: NDArray[np.float64]
    """TCP pose of the grasp in the base frame, (7,)."""
    joints_above: NDArray[np.float64]
    """Joints of the pose above it [rad], (dof,)."""
    joints: NDArray[np.float64]
    """Joints of the grasp [rad], (dof,)."""
    joints_lifted: NDArray[np.float64]
    """Joints of a pose high above it, which may lean differently [rad], (dof,)."""


@dataclass(frozen=True, kw_only=True)
class Freedom:
    """How exactly an arm can be asked to point."""

    tilts: tuple[float, ...]
    """Angles by which the tool may lean away from the base [rad], in the order of preference."""
    options: IkOptions
    """For solves near the last joints."""
    first: IkOptions
    """For the first solve of a plan, which may be far from where the arm is."""


def freedom_of(kinematics: DampedLeastSquares) -> Freedom:
    """Return what an arm can be asked for: any pose, or, with fewer than six joints, a place and about a direction."""
    if kinematics.dof >= 6:
        exact = IkOptions(restarts=0, iterations=100)
        return Freedom(tilts=(0.0,), options=exact, first=exact)
    tilts = tuple(float(tilt) for tilt in np.deg2rad([0.0, 15.0, -15.0, 30.0, -30.0, 45.0, 60.0, 75.0, 90.0]))
    options, first = (
        IkOptions(
            restarts=restarts,
            iterations=100,
            rotation_weight=0.03,
            rotation_tolerance=0.2,
            translation_tolerance=5e-4,
        )
        for restarts in (0, 10)
    )
    return Freedom(tilts=tilts, options=options, first=first)


def plan_top_grasp(
    where: Pose,
    across: NDArray[np.float64],
    start: NDArray[np.float64],
    kinematics: DampedLeastSquares,
    clearance: float,
    lift: float,
) -> GraspPlan | None:
    """Plan a grasp from above, tilted as little and with the joints turned as little as may be.

    Of the two ways to turn a symmetric gripper, the one with the smaller largest joint motion is taken.

    Args:
        where: Pose whose origin is to be grasped, in the base frame.
        across: Direction along which the fingers close, in the base frame, shape (3,).
        start: Joints to start from [rad], shape (dof,).
        kinematics: Of the arm with its gripper.
        clearance: The pose this far above must be feasible too [m].
        lift: Height to lift to [m].

    Returns:
        The plan, with tool z down and tool y across; None when nothing is feasible.
    """
    yaw = float(np.arctan2(-across[0], across[1]))
    freedom = freedom_of(kinematics)
    axis = first_axis(kinematics, start)
    for tilt in freedom.tilts:
        best: GraspPlan | None = None
        best_turn = np.inf
        for candidate in (yaw, yaw + np.pi):
            plan = _reach(where, axis, candidate, tilt, start, kinematics, freedom, clearance, lift)
            if plan is not None and (turn := float(np.abs(plan.joints - start).max())) < best_turn:
                best, best_turn = plan, turn
        if best is not None:
            return best
    return None


def first_axis(kinematics: DampedLeastSquares, joints: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return x, y of the first joint's axis in the base frame [m]; the axis must be upright."""
    turned = joints.copy()
    turned[0] += 1.0 if joints[0] < 0 else -1.0
    before, after = kinematics.forward(joints), kinematics.forward(turned)
    turn = (after * before.inverse()).matrix
    # A point c of the axis has R c + t = c.
    return np.asarray(np.linalg.solve(np.eye(2) - turn[:2, :2], turn[:2, 3]), np.float64)


def _leaning(where: Pose, axis: NDArray[np.float64], yaw: float, tilt: float, height: float) -> Pose:
    """Return the TCP pose `height` above a place, tool y at `yaw`, leaning away from the first axis by `tilt`."""
    x, y, z = where.translation
    azimuth = float(np.arctan2(y - axis[1], x - axis[0]))
    # About the horizontal axis across the arm's plane, so that an arm with five joints can follow.
    lean = Pose.from_rotvec((0, 0, 0), (tilt * np.sin(azimuth), -tilt * np.cos(azimuth), 0.0))
    # A half turn about x points the tool down, then the yaw.
    return Pose((x, y, z + height)) * lean * Pose.from_rpy((0, 0, 0), (np.pi, 0.0, yaw))


def _reach(
    where: Pose,
    axis: NDArray[np.float64],
    yaw: float,
    tilt: float,
    start: NDArray[np.float64],
    kinematics: DampedLeastSquares,
    freedom: Freedom,
    clearance: float,
    lift: float,
) -> GraspPlan | None:
    options = freedom.options
    above = kinematics.inverse(_leaning(where, axis, yaw, tilt, clearance), start, freedom.first)
    grasp = _leaning(where, axis, yaw, tilt, 0.0)
    down = kinematics.inverse(grasp, above.joints, options)
    if above.status != IkStatus.ok or down.status != IkStatus.ok:
        return None
    for other in sorted(freedom.tilts, key=lambda angle: abs(angle - tilt)):
        lifted = kinematics.inverse(_leaning(where, axis, yaw, other, lift), above.joints, options)
        if lifted.status == IkStatus.ok:
            return GraspPlan(
                tcp=grasp.tquat, joints_above=above.joints, joints=down.joints, joints_lifted=lifted.joints
            )
    return None
