"""Plans joint motions past obstacles: to joints, or to a pose of the TCP."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs._core import CollisionChecker, IkStatus, Kinematics
from rcs.errors import InvalidSetup, PlanningFailed
from rcs.kinematics import freedom_of
from rcs.planning.path import Path, TimedPath
from rcs.planning.search import Problem, search
from rcs.planning.timing import JointLimits, time_path
from rcs.spatial import Pose

STEP, TURN = 0.005, 0.035
"""How finely motions are checked near obstacles during the search [m, rad]; half of it is below the margin."""
ATTEMPTS = 64
"""Random starts from which inverse kinematics looks for joints that reach a pose."""
APART = 0.1
"""Solutions of inverse kinematics nearer to each other than this are one [rad]."""
SHORTCUTS = 24
"""Random shortcuts that are tried on a path."""
BEYOND = np.pi
"""How far beyond start and goals to search [rad]: joints of some arms turn twice, most of which leads nowhere."""
INSIDE = 1e-4
"""By how much margins are lowered below the distance at which a path begins or ends [m]."""

Rows = NDArray[np.float64]


class Planner:
    """Plans for the joints of a collision checker, of one robot or of several.

    Same checker, seed and arguments, same path, as long as the time limit does not end the search.
    """

    def __init__(
        self,
        checker: CollisionChecker,
        limits: JointLimits,
        kinematics: Kinematics | None = None,
        *,
        margin: float = 0.005,
        planner: str = "RRTConnect",
        time_limit: float = 5.0,
        iterations: int = 1000,
    ) -> None:
        """Prepare to plan; nothing is computed.

        Args:
            checker: Knows the robots and what is around them, as it stands when a path is planned.
            limits: Limits of the joints, for times.
            kinematics: Kinematics of the robot, for goals that are poses; None if there are several robots.
            margin: Distance that paths keep [m]. Where the start or the goal is nearer, this path keeps theirs.
            planner: Name of a planner: RRT, RRTConnect, RRTstar, FMT, BITstar, or another one of OMPL; EST needs no
                extra.
            time_limit: Longest search [s].
            iterations: Iterations of planners that improve their path, such as RRTstar.

        Raises:
            InvalidSetup: A number is not valid, or kinematics and checker have different numbers of joints.
        """
        if not margin >= 0.0 or not time_limit > 0.0 or iterations < 1:
            raise InvalidSetup(
                f"margin is {margin!r}, time_limit {time_limit!r} and iterations {iterations!r}; valid are at least 0, "
                "above 0 and at least 1."
            )
        if kinematics is not None and kinematics.dof != checker.dof:
            raise InvalidSetup(f"The kinematics have {kinematics.dof} joints, the collision checker {checker.dof}.")
        if len(limits.velocity) != checker.dof:
            raise InvalidSetup(f"There are limits for {len(limits.velocity)} joints, the checker has {checker.dof}.")
        self.checker = checker
        """Distances and contacts; `set_state`, `attach` and `allow` change what later paths have to avoid."""
        self.limits = limits
        """Limits of the joints."""
        self.kinematics = kinematics
        """Kinematics of the robot, in its base frame."""
        self.margin = margin
        """Distance that paths keep [m]."""
        self.planner = planner
        """Name of the planner."""
        self.time_limit = time_limit
        """Longest search [s]."""
        self.iterations = iterations
        """Iterations of planners that improve their path."""

    def plan(self, start: ArrayLike, goal: ArrayLike | Pose, *, seed: int = 0, shortcut: bool = True) -> Path:
        """Return a path that touches nothing.

        Args:
            start: Joints [rad], (dof,).
            goal: Joints [rad], (dof,), or several of which any will do, (n, dof); or a pose of the TCP in the base
                frame. A pose may have many solutions: those found that are free are all goals.
            seed: Seed of everything random.
            shortcut: Whether to shorten the path.

        Raises:
            PlanningFailed: The start or the goal collides, the pose is out of reach, or no path is found in time; its
                `reason` is `start`, `goal`, `unreachable` or `time`.
            InvalidSetup: Joints are of a wrong number, not finite or outside their limits.
            UnknownName: There is no planner of this name.
            MissingDependency: The planner is one of OMPL, which is not installed.
        """
        find = search(self.planner)
        first = self._joints("start", start)[0]
        self._require_free("start", first[None])
        goals = self.goals(goal, start=first, seed=seed) if isinstance(goal, Pose) else self._joints("goal", goal)
        goals = self._require_free("goal", goals)
        ends = np.vstack([first[None], goals])
        nearest = float(self.checker.clearance_rows(ends, self.margin + INSIDE)[0].min())
        problem = Problem(
            checker=self.checker,
            start=first,
            goals=goals,
            lower=np.maximum(self.checker.joint_lower, ends.min(axis=0) - BEYOND),
            upper=np.minimum(self.checker.joint_upper, ends.max(axis=0) + BEYOND),
            margin=max(min(self.margin, nearest - INSIDE), 0.0),
            step=STEP,
            turn=TURN,
            seed=seed,
            time_limit=self.time_limit,
            iterations=self.iterations,
        )
        if problem.margin < STEP / 2:
            problem = replace(problem, step=max(2.0 * problem.margin, STEP / 5))
        direct = goals[problem.connect_rows(np.broadcast_to(first, goals.shape), goals)]
        if len(direct):
            rows = np.array([first, direct[np.argmin(np.linalg.norm(direct - first, axis=1))]])
        else:
            rows = find(problem)
        if rows is None:
            raise PlanningFailed(
                f"{self.planner} has found no path in {self.time_limit:g} s. Raise time_limit, lower margin "
                f"({self.margin:g} m), or check that there is a way.",
                reason="time",
            )
        return Path(shorten(rows, problem) if shortcut and len(rows) > 2 else rows)

    def goals(self, pose: Pose, *, start: ArrayLike, seed: int = 0) -> Rows:
        """Return joints that reach a pose of the TCP in the base frame, nearest to the start first, (n, dof).

        Inverse kinematics looks from the start and from random joints; solutions that are nearly the same count once.

        Raises:
            PlanningFailed: No joints inside the limits reach it.
            InvalidSetup: This planner has no kinematics.
        """
        if self.kinematics is None:
            raise InvalidSetup(
                "This planner has no kinematics, so a goal must be joints; give Planner(kinematics=...)."
            )
        first = self._joints("start", start)[0]
        lower, upper = self.kinematics.joint_lower, self.kinematics.joint_upper
        starts = np.random.default_rng(seed).uniform(lower, upper, (ATTEMPTS, len(lower)))
        starts[0] = first
        targets = np.tile(pose.tquat, (ATTEMPTS, 1))
        joints, status, _ = self.kinematics.inverse_batch(targets, starts, freedom_of(self.kinematics))
        found = joints[status == IkStatus.ok.value]
        if not len(found):
            x, y, z = pose.translation
            raise PlanningFailed(
                f"No joints inside the limits reach the TCP pose at {x:.3f}, {y:.3f}, {z:.3f} m in the base frame, "
                f"from {ATTEMPTS} starts. Move or turn it.",
                reason="unreachable",
            )
        different: list[Rows] = []
        for q in found[np.argsort(np.linalg.norm(found - first, axis=1), kind="stable")]:
            if all(np.abs(q - other).max() > APART for other in different):
                different.append(q)
        return np.array(different)

    def time(self, path: Path, *, bend: float = 0.5) -> TimedPath:
        """Give a path times, within the limits of the joints; corners are rounded off where that touches nothing.

        Args:
            path: The path.
            bend: How long rounded corners may be [rad].
        """
        nearest = self.checker.clearance_rows(path.waypoints, self.margin + INSIDE)[0].min()
        margin = max(min(self.margin, float(nearest) - INSIDE), 0.0)

        def is_free(rows: Rows) -> bool:
            return bool(np.isinf(self.checker.first_hit_rows(rows[:-1], rows[1:], STEP / 5, TURN, margin)[0]).all())

        return time_path(path, self.limits, bend=bend, is_free=is_free)

    def _joints(self, name: str, given: ArrayLike) -> Rows:
        rows = np.atleast_2d(np.asarray(given, np.float64))
        if rows.ndim != 2 or rows.shape[1] != self.checker.dof or not len(rows) or not np.isfinite(rows).all():
            raise InvalidSetup(
                f"The {name} has the shape {np.shape(given)}; valid are {self.checker.dof} finite joints [rad]."
            )
        lower, upper = self.checker.joint_lower, self.checker.joint_upper
        outside = np.argwhere((rows < lower - 1e-6) | (rows > upper + 1e-6))
        if len(outside):
            row, joint = outside[0]
            raise InvalidSetup(
                f"Joint {joint + 1} of the {name} is {rows[row, joint]:.4f} rad; valid is {lower[joint]:.4f} to "
                f"{upper[joint]:.4f}."
            )
        return np.clip(rows, lower, upper)

    def _require_free(self, name: str, rows: Rows) -> Rows:
        """Return the rows that touch nothing; one is enough."""
        distances, geoms = self.checker.clearance_rows(rows, INSIDE)
        free = rows[distances >= INSIDE]
        if len(free):
            return free
        deepest = int(np.argmax(distances))
        a, b = (self.checker.describe(int(geom)) for geom in geoms[deepest])
        raise PlanningFailed(
            f"The {name} is in collision: {a} and {b} are {1e3 * max(-distances[deepest], 0.0):.1f} mm inside each "
            "other. Move it, or let the two touch with checker.allow.",
            reason="start" if name == "start" else "goal",
        )


def shorten(rows: Rows, problem: Problem) -> Rows:
    """Return a path (n, dof) from which random detours are cut off, with the same ends and free of contact."""
    random = np.random.default_rng(problem.seed)
    rows = _without_middles(rows, problem)
    for _ in range(SHORTCUTS):
        if len(rows) == 2:
            break
        way = np.concatenate([[0.0], np.linalg.norm(np.diff(rows, axis=0), axis=1).cumsum()])
        a, b = np.sort(random.uniform(0.0, way[-1], 2))
        i, j = np.searchsorted(way, [a, b], side="right") - 1
        if i == j:
            continue
        cut = np.array([[np.interp(at, way, column) for column in rows.T] for at in (a, b)])
        shorter = np.linalg.norm(cut[1] - cut[0]) < b - a - 1e-6
        if shorter and problem.connects(cut[0], cut[1]):
            rows = np.vstack([rows[: i + 1], cut, rows[j + 1 :]])
    return _without_middles(rows, problem)


def _without_middles(rows: Rows, problem: Problem) -> Rows:
    """Leave out waypoints whose neighbours connect."""
    i = 1
    while i < len(rows) - 1:
        if problem.connects(rows[i - 1], rows[i + 1]):
            rows = np.delete(rows, i, axis=0)
        else:
            i += 1
    return rows
