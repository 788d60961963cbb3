"""Searches for a path between joints: OMPL's geometric planners by name, and EST, which needs no extra."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs._core import CollisionChecker
from rcs.errors import MissingDependency, UnknownName

PLANNERS = ("EST", "RRT", "RRTConnect", "RRTstar", "FMT", "BITstar")
"""Tested planners, which return the same path for the same seed; OMPL has other geometric ones."""
OPTIMISING = (
    "RRTstar",
    "BITstar",
    "PRMstar",
    "InformedRRTstar",
    "SORRTstar",
    "AORRTC",
    "LBTRRT",
    "ABITstar",
    "AITstar",
)
"""Planners that improve their path until their iterations are up."""
RANGE = 0.6
"""Longest motion that a tree of OMPL grows by [rad]. OMPL's own choice, a fifth of the space's extent, is 2.5 rad for
seven joints: most such motions run into something."""
SEEDS = 2**31
"""Number of seeds of OMPL."""
REACH = 0.2
"""Longest motion that a tree of EST grows by, as a share of the diagonal of the joints' ranges."""
NEAR = 3
"""Points of EST's other tree that each new point is tried to be joined to."""

Rows = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """The problem of a path from a start to any of some goals, all of them free."""

    checker: CollisionChecker
    start: Rows
    """rad, (dof,)"""
    goals: Rows
    """rad, (n, dof)"""
    lower: Rows
    """Smallest joints of the search [rad], (dof,)."""
    upper: Rows
    """Largest joints of the search [rad], (dof,)."""
    margin: float
    """Distance to keep [m]."""
    step: float
    """Largest motion of any point between two checks near obstacles [m]."""
    turn: float
    """Largest rotation between these [rad]."""
    seed: int
    time_limit: float
    """Longest search [s]."""
    iterations: int
    """Iterations of planners that improve their path."""

    def is_free(self, q: Rows) -> bool:
        """Return whether joints (dof,) keep the margin."""
        return self.checker.is_free(q, self.margin)

    def connects(self, a: Rows, b: Rows) -> bool:
        """Return whether the straight motion keeps the margin."""
        return self.checker.first_hit(a, b, self.step, self.turn, self.margin) is None

    def connect_rows(self, a: Rows, b: Rows) -> NDArray[np.bool_]:
        """Return which straight motions, (n, dof) to (n, dof), keep the margin."""
        return np.isinf(self.checker.first_hit_rows(a, b, self.step, self.turn, self.margin)[0])


Search = Callable[[Problem], "Rows | None"]


def search(name: str) -> Search:
    """Return a planner by its name.

    Raises:
        UnknownName: There is no planner of this name.
        MissingDependency: It is one of OMPL, which is not installed.
    """
    if name == "EST":
        return expansive_trees
    geometric = _ompl("geometric")
    known = [n for n in dir(geometric) if hasattr(getattr(geometric, n), "setProblemDefinition") and n != "Planner"]
    if name not in known:
        raise UnknownName("planner", name, sorted({*known, "EST"}))
    return lambda problem: _solve(getattr(geometric, name), name in OPTIMISING, problem)


def _ompl(module: str) -> Any:
    try:
        return importlib.import_module(f"ompl.{module}")
    except ImportError as err:
        raise MissingDependency(
            "This planner needs ompl: pip install 'robot-control-stack[planning]'. The planner EST needs no extra."
        ) from err


def _solve(planner: Any, is_optimising: bool, problem: Problem) -> Rows | None:
    """Run a planner of OMPL; None if it finds no way in time."""
    base, util = _ompl("base"), _ompl("util")
    util.setLogLevel(util.LOG_NONE)  # it writes to standard output
    # Generators made from here on follow from this seed, which OMPL wants above 0.
    util.RNG.setSeed(problem.seed % SEEDS + 1)
    dof = problem.checker.dof
    space = base.RealVectorStateSpace(dof)
    bounds = base.RealVectorBounds(dof)
    for i, (low, high) in enumerate(zip(problem.lower, problem.upper, strict=True)):
        bounds.setLow(i, float(low))
        bounds.setHigh(i, float(high))
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(lambda state: problem.is_free(np.array(state[0:dof])))
    information.setMotionValidator(_swept()(information, problem))
    information.setup()

    def state_of(q: Rows) -> Any:
        state = space.allocState()  # copyFromReals ends the process (ompl 2.0.1)
        for i, value in enumerate(q):
            state[i] = float(value)
        return state

    # Without start and goal, a planner's setup ends the process.
    definition = base.ProblemDefinition(information)
    definition.addStartState(state_of(problem.start))
    goals = base.GoalStates(information)
    for goal in problem.goals:
        goals.addState(state_of(goal))
    definition.setGoal(goals)
    if is_optimising:
        definition.setOptimizationObjective(base.PathLengthOptimizationObjective(information))
    made = planner(information)
    if hasattr(made, "setRange"):
        made.setRange(RANGE)
    made.setProblemDefinition(definition)
    made.setup()
    end, calls = time.monotonic() + problem.time_limit, 0

    def is_over() -> bool:
        nonlocal calls
        calls += 1
        return (is_optimising and calls > problem.iterations) or time.monotonic() > end

    while not definition.hasExactSolution() and time.monotonic() < end:  # an optimising one may need another round
        calls = 0
        made.solve(base.PlannerTerminationCondition(is_over))
        if not is_optimising:
            break
    if not definition.hasExactSolution():
        return None
    path = definition.getSolutionPath()
    return np.array([path.getState(i)[0:dof] for i in range(path.getStateCount())])


@cache
def _swept() -> Any:
    """Return a class of OMPL's motion validators; made once, since classes are not freed."""

    class Swept(_ompl("base").MotionValidator):
        """Checks whole motions in C++ instead of states along them."""

        def __init__(self, information: Any, problem: Problem) -> None:
            super().__init__(information)
            self._problem, self._dof = problem, problem.checker.dof

        def checkMotion(self, a: Any, b: Any, *_: Any) -> bool:  # noqa: N802  OMPL's name
            return self._problem.connects(np.array(a[0 : self._dof]), np.array(b[0 : self._dof]))

    return Swept


def expansive_trees(problem: Problem) -> Rows | None:
    """Grow trees from start and goals where they are thin, and return a path (n, dof); None if none is found in time.

    D. Hsu, J.-C. Latombe and R. Motwani: "Path Planning in Expansive Configuration Spaces", 1997.
    """
    end = time.monotonic() + problem.time_limit
    random = np.random.default_rng(problem.seed)
    lower, upper = problem.lower, problem.upper
    reach = REACH * float(np.linalg.norm(upper - lower))
    trees = [_Tree(problem.start[None], reach / 3), _Tree(problem.goals, reach / 3)]
    turn = 0
    while time.monotonic() < end:
        tree, other = trees[turn], trees[1 - turn]
        origin = tree.draw(random)
        motion = random.normal(size=len(lower))
        motion *= reach * random.uniform() ** (1.0 / len(lower)) / np.linalg.norm(motion)  # uniform in a ball
        point = np.clip(tree.points[origin] + motion, lower, upper)
        if problem.is_free(point) and problem.connects(tree.points[origin], point):
            added = tree.add(point, origin)
            apart = np.linalg.norm(np.array(other.points) - point, axis=1)
            for there in np.argsort(apart, kind="stable")[:NEAR].tolist():
                if problem.connects(point, other.points[there]):
                    first, second = (tree, added), (other, there)
                    (start, i), (goal, j) = (first, second) if turn == 0 else (second, first)
                    return np.array(start.path_to_root(i)[::-1] + goal.path_to_root(j))
            turn = 1 - turn
    return None


class _Tree:
    def __init__(self, roots: Rows, radius: float) -> None:
        self.points = [np.array(root) for root in roots]
        self._parents = [-1] * len(roots)
        self._neighbours = [1] * len(roots)
        self._radius = radius

    def draw(self, random: np.random.Generator) -> int:
        """Return a point, the more likely the fewer others are near."""
        weights = 1.0 / np.array(self._neighbours)
        return int(random.choice(len(weights), p=weights / weights.sum()))

    def add(self, point: Rows, parent: int) -> int:
        near = np.nonzero(np.linalg.norm(np.array(self.points) - point, axis=1) < self._radius)[0]
        for i in near:
            self._neighbours[i] += 1
        self.points.append(point)
        self._parents.append(parent)
        self._neighbours.append(1 + len(near))
        return len(self.points) - 1

    def path_to_root(self, at: int) -> list[Rows]:
        found: list[Rows] = []
        while at >= 0:
            found.append(self.points[at])
            at = self._parents[at]
        return found
