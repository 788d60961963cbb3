"""A path: joint positions that are connected by straight lines in joint space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs.errors import InvalidSetup


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
        from rcs_data.diversity import at_shares  # on use: it imports pyarrow

        return at_shares(self.waypoints, shares)


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
    from rcs_data.diversity import diversity_of_ways  # on use: it imports pyarrow

    return diversity_of_ways([(path if isinstance(path, Path) else Path(path)).waypoints for path in paths])
