"""PRM: joins random free joints to their nearest neighbours and looks for the shortest way (Kavraki et al. 1996)."""

from __future__ import annotations

import heapq
import time

import numpy as np
from numpy.typing import NDArray

from rcs.planning.search import Problem

BATCH = 100
"""Joints that are drawn between two looks for a way."""
NEIGHBOURS = 8
"""Of each that it is joined to."""

Rows = NDArray[np.float64]


def roadmap(problem: Problem) -> Rows | None:
    """Return a way (n, dof); None if none is found in time. Batches are drawn until one is found."""
    end = time.monotonic() + problem.time_limit
    random = np.random.default_rng(problem.seed)
    lower, upper = problem.lower, problem.upper
    points = np.vstack([problem.start, problem.goals])
    first_sample = len(points)
    edges: list[dict[int, float]] = [{} for _ in points]
    fresh = list(range(first_sample))
    while True:
        _join(problem, points, edges, fresh)
        way = _shortest(edges, range(1, first_sample))
        if way is not None:
            return points[way]
        if time.monotonic() > end:
            return None
        drawn = random.uniform(lower, upper, (BATCH, len(lower)))
        drawn = drawn[problem.checker.free_rows(drawn, problem.margin)]
        fresh = list(range(len(points), len(points) + len(drawn)))
        points = np.vstack([points, drawn])
        edges += [{} for _ in fresh]


def _join(problem: Problem, points: Rows, edges: list[dict[int, float]], fresh: list[int]) -> None:
    """Join new points to their nearest ones where the straight motion is free."""
    pairs: set[tuple[int, int]] = set()
    for i in fresh:
        apart = np.linalg.norm(points - points[i], axis=1)
        apart[i] = np.inf
        pairs |= {(min(i, j), max(i, j)) for j in np.argsort(apart, kind="stable")[:NEIGHBOURS].tolist() if j != i}
    if not pairs:
        return
    rows = np.array(sorted(pairs))
    for (i, j), is_free in zip(
        rows.tolist(), problem.connect_rows(points[rows[:, 0]], points[rows[:, 1]]), strict=True
    ):
        if is_free:
            edges[i][j] = edges[j][i] = float(np.linalg.norm(points[i] - points[j]))


def _shortest(edges: list[dict[int, float]], goals: range) -> list[int] | None:
    """Return the points on the shortest way from the first one to a goal (Dijkstra)."""
    best, before = {0: 0.0}, {0: 0}
    queue = [(0.0, 0)]
    while queue:
        so_far, here = heapq.heappop(queue)
        if so_far > best[here]:
            continue
        if here in goals:
            way = [here]
            while way[-1] != 0:
                way.append(before[way[-1]])
            return way[::-1]
        for there, length in edges[here].items():
            if so_far + length < best.get(there, np.inf):
                best[there], before[there] = so_far + length, here
                heapq.heappush(queue, (so_far + length, there))
    return None
