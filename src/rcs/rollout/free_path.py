"""Checks that straight motions of an arm in a simulated scene keep a margin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rcs.envs.env import Env
from rcs.envs.planner_for import planner_for

MARGIN = 0.01
"""Least distance of the robot's shapes from all others [m]."""
STEP, TURN = 0.002, 0.01
"""Largest motion of any point and largest rotation between two checks near obstacles [m, rad]."""
ROUNDING = 1e-5
"""Largest decrease of the distance to obstacles near the start [m]."""
LOOKS = 20
"""Points of a path that starts near an obstacle at which to check whether it is still near."""


class FreePath:
    """Checks paths of one arm; everything else stays where it is at the time.

    The shapes are those that collide in the scene. A path that starts near something may lead away from it, but no
    nearer; from where nothing is near any more, it keeps the margin.
    """

    def __init__(self, env: Env, robot: str) -> None:
        """Use the scene of an environment.

        Args:
            env: A simulated environment of one copy.
            robot: Name of the robot.
        """
        self._planner = planner_for(env, robot)

    def __call__(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> bool:
        """Return whether the arm may go straight from joints to joints [rad], (dof,) each."""
        self._planner.look()
        checker = self._planner.checker
        nearest = checker.clearance(start, MARGIN).distance
        if nearest >= MARGIN:
            return checker.first_hit(start, end, STEP, TURN, MARGIN) is None
        ways = start + np.linspace(0.0, 1.0, LOOKS + 1)[1:, None] * (end - start)
        away = ways[checker.free_rows(ways, MARGIN)]
        left = away[0] if len(away) else end
        return (
            checker.first_hit(start, left, STEP, TURN, nearest - ROUNDING) is None
            and checker.first_hit(left, end, STEP, TURN, MARGIN if len(away) else nearest - ROUNDING) is None
        )
