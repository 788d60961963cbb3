"""Looks for a path between joints: OMPL's geometric planners by name, and PRM and EST of our own.

OMPL's Python package has no EST, and its PRM ends when a second thread looks, so that the same seed gives another path.
"""

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

PLANNERS = ("PRM", "RRT", "RRTConnect", "RRTstar", "EST", "FMT", "BITstar")
"""Planners that are tried and documented; OMPL's other geometric ones go by their names, too."""
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
"""Planners that go on after the first path, until their iterations are up."""
RANGE = 0.6
"""Longest motion that a tree grows by [rad]. OMPL's own choice, a fifth of the space's extent, is 2.5 rad for seven
joints: most such motions run into something."""
SEEDS = 2**31
"""Seeds that OMPL takes."""

Rows = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """What is looked for: a way from a start to any of some goals, all of them free."""

    checker: CollisionChecker
    start: Rows
    """rad, (dof,)"""
    goals: Rows
    """rad, (n, dof)"""
    lower: Rows
    """Where it is looked for [rad], (dof,)."""
    upper: Rows
    margin: float
    """Distance to keep [m]."""
    step: float
    """Between two checks of what is near [m]."""
    turn: float
    """The same for rotations [rad]."""
    seed: int
    time_limit: float
    """s"""
    iterations: int
    """Of planners that improve their path."""

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
    """Return the planner of a name.

    Raises:
        UnknownName: There is none.
        MissingDependency: It is OMPL's, which is not installed.
    """
    if name == "PRM":
        from rcs.planning.roadmap import roadmap

        return roadmap
    if name == "EST":
        from rcs.planning.expansive import expansive

        return expansive
    geometric = _ompl("geometric")
    known = [n for n in dir(geometric) if hasattr(getattr(geometric, n), "setProblemDefinition") and n != "Planner"]
    if name not in known:
        raise UnknownName("planner", name, sorted({*known, "PRM", "EST"}))
    return lambda problem: _solve(getattr(geometric, name), name in OPTIMISING, problem)


def _ompl(module: str) -> Any:
    try:
        return importlib.import_module(f"ompl.{module}")
    except ImportError as err:
        raise MissingDependency(
            "This planner needs ompl: pip install 'robot-control-stack[planning]'. PRM and EST need nothing."
        ) from err


def _solve(planner: Any, is_optimising: bool, problem: Problem) -> Rows | None:
    """Run a planner of OMPL; None if it finds no way in time."""
    base, util = _ompl("base"), _ompl("util")
    util.setLogLevel(util.LOG_NONE)  # it says on standard output what is returned here
    # Generators made from here on follow from this seed; OMPL takes none of 0.
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

    # Start and goal before any setup of a planner, which would end the process without them.
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
    end, asked = time.monotonic() + problem.time_limit, 0

    def is_over() -> bool:
        nonlocal asked
        asked += 1
        return (is_optimising and asked > problem.iterations) or time.monotonic() > end

    while not definition.hasExactSolution() and time.monotonic() < end:  # an optimising one may need another round
        asked = 0
        made.solve(base.PlannerTerminationCondition(is_over))
        if not is_optimising:
            break
    if not definition.hasExactSolution():
        return None
    path = definition.getSolutionPath()
    return np.array([path.getState(i)[0:dof] for i in range(path.getStateCount())])


@cache
def _swept() -> Any:
    """Return a class of OMPL's motion validators; made once, as classes are never given back."""

    class Swept(_ompl("base").MotionValidator):
        """Checks whole motions in C++ instead of states along them."""

        def __init__(self, information: Any, problem: Problem) -> None:
            super().__init__(information)
            self._problem, self._dof = problem, problem.checker.dof

        def checkMotion(self, a: Any, b: Any, *_: Any) -> bool:  # noqa: N802  OMPL's name
            return self._problem.connects(np.array(a[0 : self._dof]), np.array(b[0 : self._dof]))

    return Swept
