"""The answer of a policy: the actions of the next moments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vlagents.errors import InvalidInput


@dataclass(frozen=True)
class Chunk:
    """Actions in physical units, one row per moment, from the time of the observation on.

    Row i is for the time from `time + i · period` to `time + (i + 1) · period`. Rows are executed by time, not count:
    a late answer then skips the rows that are over, and does not lag.
    """

    actions: NDArray[np.float64]
    """(horizon, size): columns are the metadata's parts of an action, side by side. The chunk has a copy."""
    period: float
    """Time that each row is for [s]."""
    time: float = 0.0
    """Time of the observation that the chunk answers [s], by the robot's clock."""
    info: Mapping[str, float | str] = field(default_factory=dict)
    """More values of the policy, such as `infer_ms`."""

    def __post_init__(self) -> None:
        """Check shape and numbers: nothing that is not finite ever gets to a robot.

        Raises:
            InvalidInput: One is wrong.
        """
        actions = np.array(self.actions, np.float64)
        object.__setattr__(self, "actions", actions)
        if actions.ndim != 2 or actions.shape[0] < 1 or actions.shape[1] < 1:
            raise InvalidInput(f"actions have the shape {actions.shape}; valid is (horizon, size), at least (1, 1).")
        if not np.isfinite(actions).all():
            row = int(np.flatnonzero(~np.isfinite(actions).all(axis=1))[0])
            raise InvalidInput(f"Row {row} of actions has a value that is not finite: {actions[row]}.")
        if not (np.isfinite(self.period) and self.period > 0):
            raise InvalidInput(f"period is {self.period!r}; valid is a number of seconds above 0.")
        if not np.isfinite(self.time):
            raise InvalidInput(f"time is {self.time!r}; valid is a finite number of seconds.")
