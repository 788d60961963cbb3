"""A teacher that puts the cuboid on its mark from wherever the arm is, so that it can label every state."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rcs.agents.pick_teacher import SLOWED, Goal, PickTeacher
from rcs.envs.spaces import IS_GRASPED, PRIVILEGED, TQUAT, Observation
from rcs.tasks.pick_cuboid import CUBOID
from rcs.tasks.place import MARK, Place

CARRIED = 0.06
"""Height above the table at which the cuboid is carried [m]."""
ALIGNED = 0.005
"""Distance beside the mark's middle up to which the cuboid is lowered [m]."""
STEEPNESS = 2.5
"""Height to keep per distance beyond that [m/m]."""
PRESSED = 0.002
"""Depth below the table to which it is lowered [m], so that it comes to lie on it."""
SET_DOWN = (0.012, 0.004)
"""Distance beside the mark's middle and height above the table at which it is let go, or left where it is [m]."""
RETREAT = 0.05
"""Height by which the open hand goes up from there [m]."""


class PlaceTeacher(PickTeacher):
    """Puts the cuboid on its mark with one step of feedback per action, from any state, and remembers nothing.

    It grasps as `PickTeacher` does, lifts, carries the cuboid into a funnel that leads down to the mark, and lets go of
    it where it stands. A cuboid that lies on the mark is left alone, even one that fell there and does not count: only
    a memory would tell. `PlaceExpert` goes through phases instead.
    """

    task = Place

    def _go_on(
        self,
        observation: Observation,
        start: NDArray[np.float64],
        goal: NDArray[np.float64],
        is_held: NDArray[np.bool_],
        opens: NDArray[np.bool_],
    ) -> Goal:
        """Return the goal, with what to do where the cuboid is held, and where it lies on its mark."""
        cuboid, mark = (observation[PRIVILEGED][name][TQUAT] for name in (CUBOID, MARK))
        way = mark[..., :3] - cuboid[..., :3]
        aside, above = np.hypot(way[..., 0], way[..., 1]), -0.5 * self._edges[2] - way[..., 2]
        keeps = np.minimum(STEEPNESS * np.maximum(aside - ALIGNED, 0.0), CARRIED)
        free = np.clip(1.0 - (keeps - above) / SLOWED, 0.0, 1.0)
        carried = observation[TQUAT].copy()
        carried[..., :2] += free[..., None] * way[..., :2]
        carried[..., 2] += keeps - PRESSED - above
        goal[..., :3] = np.where(is_held[..., None], carried[..., :3], goal[..., :3])
        is_set_down = (aside < SET_DOWN[0]) & (above < SET_DOWN[1])
        left = start[..., :3].copy()
        left[..., 2] += np.where(observation[IS_GRASPED][..., 0] > 0, 0.0, RETREAT)
        goal[..., :3] = np.where(is_set_down[..., None], left, goal[..., :3])
        return goal, opens | is_set_down
