"""EST: grows trees from start and goal where they are thin (Hsu, Latombe and Motwani 1997)."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from rcs.planning.search import Problem

REACH = 0.2
"""How far a new point may be from the one that it grows from, as a share of the diagonal of the joints' ranges."""
NEAR = 3
"""Points of the other tree that each new one is tried to be joined to."""

Rows = NDArray[np.float64]


class _Tree:
    def __init__(self, roots: Rows, radius: float) -> None:
        self.points = [np.array(root) for root in roots]
        self.parents = [-1] * len(roots)
        self._crowd = [1] * len(roots)
        self._radius = radius

    def draw(self, random: np.random.Generator) -> int:
        """Return a point, the more likely the fewer others are near."""
        weights = 1.0 / np.array(self._crowd)
        return int(random.choice(len(weights), p=weights / weights.sum()))

    def add(self, point: Rows, parent: int) -> int:
        near = np.nonzero(np.linalg.norm(np.array(self.points) - point, axis=1) < self._radius)[0]
        for i in near:
            self._crowd[i] += 1
        self.points.append(point)
        self.parents.append(parent)
        self._crowd.append(1 + len(near))
        return len(self.points) - 1

    def way(self, at: int) -> list[Rows]:
        """Return the points from one to its root."""
        way: list[Rows] = []
        while at >= 0:
            way.append(self.points[at])
            at = self.parents[at]
        return way


def expansive(problem: Problem) -> Rows | None:
    """Return a way (n, dof); None if none is found in time."""
    end = time.monotonic() + problem.time_limit
    random = np.random.default_rng(problem.seed)
    lower, upper = problem.lower, problem.upper
    reach = REACH * float(np.linalg.norm(upper - lower))
    trees = [_Tree(problem.start[None], reach / 3), _Tree(problem.goals, reach / 3)]
    turn = 0
    while time.monotonic() < end:
        tree, other = trees[turn], trees[1 - turn]
        origin = tree.draw(random)
        way = random.normal(size=len(lower))
        way *= reach * random.uniform() ** (1.0 / len(lower)) / np.linalg.norm(way)  # uniform in a ball
        point = np.clip(tree.points[origin] + way, lower, upper)
        if problem.is_free(point) and problem.connects(tree.points[origin], point):
            added = tree.add(point, origin)
            apart = np.linalg.norm(np.array(other.points) - point, axis=1)
            for there in np.argsort(apart, kind="stable")[:NEAR].tolist():
                if problem.connects(point, other.points[there]):
                    mine, theirs = tree.way(added), other.way(there)
                    return np.array(mine[::-1] + theirs if turn == 0 else theirs[::-1] + mine)
            turn = 1 - turn
    return None
