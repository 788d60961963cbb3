"""Plans joint motions past obstacles, by OMPL's geometric planners: to joints, or to a pose of the TCP."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs._core import CollisionChecker, IkStatus, Kinematics
from rcs.errors import InvalidSetup, PlanningFailed, UnknownName
from rcs.extras import package_of
from rcs.kinematics import freedom_of
from rcs.planning.path import JointLimits, Path, TimedPath, time_path
from rcs.spatial import Pose

OPTIMISING = ("RRTstar", "BITstar", "PRMstar", "InformedRRTstar", "SORRTstar", "AORRTC")
"""Planners that improve their path until their iterations are up."""
RANGE = 0.6
"""Longest motion that a tree of OMPL grows by [rad]. OMPL's own choice, a fifth of the space's extent, is 2.5 rad for
seven joints: most such motions run into something."""
SHORTCUTS, SNAP = 60, 0.05
"""Random shortcuts that are tried on a path, and how near to a waypoint they end at it, as a share of the length.
OMPL's own 0.005 leaves shorter paths with more corners, which take longer."""
SEEDS = 2**31
"""Number of seeds of OMPL."""
STEP, TURN = 0.005, 0.035
"""How finely motions are checked near obstacles during the search [m, rad]; half of it is below the margin."""
ATTEMPTS = 64
"""Random starts from which inverse kinematics looks for joints that reach a pose."""
APART = 0.1
"""Solutions of inverse kinematics nearer to each other than this are one [rad]."""
BEYOND = np.pi
"""How far beyond start and goals to search [rad]: joints of some arms turn twice, most of which leads nowhere."""
INSIDE = 1e-4
"""By how much margins are lowered below the distance at which a path begins or ends [m]."""

Rows = NDArray[np.float64]


@dataclass(eq=False)
class Planner:
    """Plans for the joints of a collision checker, of one robot or of several.

    Same checker, seed and arguments, same path, as long as the time limit does not end the search.
    """

    checker: CollisionChecker
    """Distances and contacts with what is around the robots when a path is planned; `set_state`, `attach` and `allow`
    change what later paths have to avoid."""
    limits: JointLimits
    """Limits of the joints, for times."""
    kinematics: Kinematics | None = None
    """Kinematics of the robot in its base frame, for goals that are poses; None if there are several robots."""
    _: KW_ONLY
    margin: float = 0.005
    """Distance that paths keep [m]. Where the start is nearer, or every goal, this path keeps theirs."""
    planner: str = "RRTConnect"
    """Name of a planner: RRT, RRTConnect, RRTstar, FMT and BITstar are tested; OMPL has other geometric ones."""
    time_limit: float = 5.0
    """Longest search [s]."""
    iterations: int = 1000
    """Iterations of planners that improve their path, such as RRTstar."""

    def __post_init__(self) -> None:
        """Check the numbers; nothing is computed.

        Raises:
            InvalidSetup: A number is not valid, or kinematics and checker have different numbers of joints.
        """
        if not self.margin >= 0.0 or not self.time_limit > 0.0 or self.iterations < 1:
            raise InvalidSetup(
                f"margin is {self.margin!r}, time_limit {self.time_limit!r} and iterations {self.iterations!r}; valid "
                "are at least 0, above 0 and at least 1."
            )
        dof, kinematics = self.checker.dof, self.kinematics
        if kinematics is not None and kinematics.dof != dof:
            raise InvalidSetup(f"The kinematics have {kinematics.dof} joints, the collision checker {dof}.")
        if len(self.limits.velocity) != dof:
            raise InvalidSetup(f"There are limits for {len(self.limits.velocity)} joints, the checker has {dof}.")

    def plan(self, start: ArrayLike, goal: ArrayLike | Pose, *, seed: int = 0) -> Path:
        """Return a path that touches nothing.

        Args:
            start: Joints [rad], (dof,).
            goal: Joints [rad], (dof,), or several of which any will do, (n, dof); or a pose of the TCP in the base
                frame. A pose may have many solutions: those found that are free are all goals. Goals for which the
                margin would have to be less than for others count where no path to these is found in half of the time.
            seed: Seed of everything random.

        Raises:
            PlanningFailed: The start or the goal collides, the pose is out of reach, or no path is found in time; its
                `reason` is `start`, `goal`, `unreachable` or `time`.
            InvalidSetup: Joints are of a wrong number, not finite or outside their limits.
            UnknownName: There is no planner of this name.
            MissingDependency: OMPL is not installed.
        """
        planner = _planner_of(self.planner)
        first = self._joints("start", start)[0]
        self._require_free("start", first[None])
        goals = self.goals(goal, start=first, seed=seed) if isinstance(goal, Pose) else self._joints("goal", goal)
        goals = self._require_free("goal", goals)
        room = self.checker.clearance_rows(np.vstack([first, goals]), self.margin + INSIDE)[0] - INSIDE
        best, least = float(room[1:].max()), float(room[1:].min())
        margin = max(min(self.margin, float(room[0]), best), 0.0)
        chosen = goals[room[1:] >= min(margin, best)]
        is_all = len(chosen) == len(goals)
        rows = self._way(planner, first, chosen, margin, seed, self.time_limit / (1 if is_all else 2))
        if rows is None and not is_all:
            rows = self._way(planner, first, goals, max(min(margin, least), 0.0), seed, self.time_limit / 2)
        if rows is None:
            raise PlanningFailed(
                f"{self.planner} has found no path in {self.time_limit:g} s. Raise time_limit, lower margin "
                f"({self.margin:g} m), or check that there is a way.",
                reason="time",
            )
        return Path(rows)

    def _way(self, planner: Any, first: Rows, goals: Rows, margin: float, seed: int, time_limit: float) -> Rows | None:
        """Return the straight way to the nearest goal that has one, or one that is found in time [s]; else None."""
        step = STEP if margin >= STEP / 2 else max(2.0 * margin, STEP / 5)
        hits = self.checker.first_hit_rows(np.broadcast_to(first, goals.shape), goals, step, TURN, margin)[0]
        direct = goals[np.isinf(hits)]
        if len(direct):
            return np.array([first, direct[np.argmin(np.linalg.norm(direct - first, axis=1))]])
        return self._search(planner, first, goals, margin, step, seed, time_limit)

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

    def time(self, path: Path) -> TimedPath:
        """Give a path times, within the limits of the joints; corners are rounded off where that touches nothing."""
        nearest = self.checker.clearance_rows(path.waypoints, self.margin + INSIDE)[0].min()
        margin = max(min(self.margin, float(nearest) - INSIDE), 0.0)

        def is_free(rows: Rows) -> bool:
            return bool(np.isinf(self.checker.first_hit_rows(rows[:-1], rows[1:], STEP / 5, TURN, margin)[0]).all())

        return time_path(path, self.limits, is_free=is_free)

    def _joints(self, name: str, given: ArrayLike) -> Rows:
        rows = np.atleast_2d(np.asarray(given, np.float64))
        is_enough = len(rows) == 1 or (len(rows) > 1 and name == "goal")
        if rows.shape[1:] != (self.checker.dof,) or not is_enough or not np.isfinite(rows).all():
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

    def _search(
        self,
        planner: Any,
        start: Rows,
        goals: Rows,
        margin: float,
        step: float,
        seed: int,
        time_limit: float,
    ) -> Rows | None:
        """Run a planner of OMPL; None if it finds no way in time."""
        base, util, checker, dof = _ompl("base"), _ompl("util"), self.checker, self.checker.dof
        util.setLogLevel(util.LOG_NONE)  # it writes to standard output
        # Generators made from here on follow from this seed, which OMPL wants above 0.
        util.RNG.setSeed(seed % SEEDS + 1)
        space = base.RealVectorStateSpace(dof)
        bounds, ends = base.RealVectorBounds(dof), np.vstack([start, goals])
        for i in range(dof):
            bounds.setLow(i, float(max(checker.joint_lower[i], ends[:, i].min() - BEYOND)))
            bounds.setHigh(i, float(min(checker.joint_upper[i], ends[:, i].max() + BEYOND)))
        space.setBounds(bounds)
        information = base.SpaceInformation(space)
        information.setStateValidityChecker(lambda state: checker.is_free(np.array(state[0:dof]), margin))
        connects: Connects = lambda a, b: checker.first_hit(a, b, step, TURN, margin) is None  # noqa: E731
        information.setMotionValidator(_swept()(information, dof, connects))
        information.setup()

        def state_of(q: Rows) -> Any:
            state = space.allocState()  # copyFromReals ends the process (ompl 2.0.1)
            for i, value in enumerate(q):
                state[i] = float(value)
            return state

        # Without start and goal, a planner's setup ends the process.
        definition = base.ProblemDefinition(information)
        definition.addStartState(state_of(start))
        wanted = base.GoalStates(information)
        for goal in goals:
            wanted.addState(state_of(goal))
        definition.setGoal(wanted)
        is_optimising = self.planner in OPTIMISING
        if is_optimising:
            definition.setOptimizationObjective(base.PathLengthOptimizationObjective(information))
        made = planner(information)
        if hasattr(made, "setRange"):
            made.setRange(RANGE)
        made.setProblemDefinition(definition)
        made.setup()
        end, calls = time.monotonic() + time_limit, 0

        def is_over() -> bool:
            nonlocal calls
            calls += 1
            return (is_optimising and calls > self.iterations) or time.monotonic() > end

        while not definition.hasExactSolution() and time.monotonic() < end:  # an optimising one may need another round
            calls = 0
            made.solve(base.PlannerTerminationCondition(is_over))
            if not is_optimising:
                break
        if not definition.hasExactSolution():
            return None
        path = definition.getSolutionPath()
        simplifier = _ompl("geometric").PathSimplifier(information)
        simplifier.reduceVertices(path)
        simplifier.partialShortcutPath(path, SHORTCUTS, SHORTCUTS, 1.0, SNAP)
        simplifier.reduceVertices(path)
        return np.array([path.getState(i)[0:dof] for i in range(path.getStateCount())])


Connects = Callable[[Rows, Rows], bool]
"""Whether the straight motion between joints keeps the margin."""


def _ompl(module: str) -> Any:
    return package_of("planning", f"ompl.{module}", "Planning needs")


def _planner_of(name: str) -> Any:
    """Return the class of a planner of OMPL."""
    geometric = _ompl("geometric")
    known = [n for n in dir(geometric) if hasattr(getattr(geometric, n), "setProblemDefinition") and n != "Planner"]
    if name not in known:
        raise UnknownName("planner", name, known)
    return getattr(geometric, name)


@cache
def _swept() -> Any:
    """Return a class of OMPL's motion validators; made once, since classes are not freed."""

    class Swept(_ompl("base").MotionValidator):
        """Checks whole motions in C++ instead of states along them."""

        def __init__(self, information: Any, dof: int, connects: Connects) -> None:
            super().__init__(information)
            self._dof, self._connects = dof, connects

        def checkMotion(self, a: Any, b: Any, *_: Any) -> bool:  # noqa: N802  OMPL's name
            return self._connects(np.array(a[0 : self._dof]), np.array(b[0 : self._dof]))

    return Swept
