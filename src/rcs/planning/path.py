"""A path: joint positions that are connected by straight lines in joint space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs.errors import InvalidSetup

COMPARED = 64
"""Points at which two paths are compared."""


@dataclass(frozen=True, eq=False)
class Path:
    """Where joints go one after the other, without times."""

    waypoints: NDArray[np.float64]
    """Joint positions [rad], (n, dof), n at least 2. The first is the start, the last the goal."""

    def __post_init__(self) -> None:
        """Take a read-only copy.

        Raises:
            InvalidSetup: There are not at least two rows of finite numbers.
        """
        rows = np.array(self.waypoints, np.float64)
        if rows.ndim != 2 or len(rows) < 2 or not np.isfinite(rows).all():
            raise InvalidSetup(
                f"The waypoints of a path have the shape {rows.shape}; valid is (n, dof), n at least 2, finite."
            )
        rows.flags.writeable = False
        object.__setattr__(self, "waypoints", rows)

    @property
    def length(self) -> float:
        """Length in joint space [rad]."""
        return float(np.linalg.norm(np.diff(self.waypoints, axis=0), axis=1).sum())

    def at(self, shares: ArrayLike) -> NDArray[np.float64]:
        """Return the joints [rad] at shares of the length, 0 … 1, (..., dof)."""
        way = np.concatenate([[0.0], np.linalg.norm(np.diff(self.waypoints, axis=0), axis=1).cumsum()])
        wanted = np.asarray(shares, np.float64) * way[-1]
        return np.stack([np.interp(wanted, way, column) for column in self.waypoints.T], axis=-1)


def diversity(paths: Sequence[Path | NDArray[np.float64]]) -> float:
    """Return how much paths differ: the mean over all pairs of the RMS distance at equal shares of the length [rad].

    Each is compared by its way alone: stretched from its own start to its own goal, so that goals that differ do not
    count as different ways. Straight motions give 0.

    Args:
        paths: Paths, or joints row by row, (n, dof); at least two.

    Raises:
        InvalidSetup: There are fewer than two.
    """
    if len(paths) < 2:
        raise InvalidSetup(f"{len(paths)} path was given; to compare takes at least 2.")
    shares = np.linspace(0.0, 1.0, COMPARED)
    rows: list[NDArray[np.float64]] = []
    for given in paths:
        path = given if isinstance(given, Path) else Path(given)
        points = path.at(shares)
        rows.append(points - (points[0] + shares[:, None] * (points[-1] - points[0])))
    apart = [float(np.sqrt(((a - b) ** 2).sum(-1).mean())) for i, a in enumerate(rows) for b in rows[:i]]
    return float(np.mean(apart))
