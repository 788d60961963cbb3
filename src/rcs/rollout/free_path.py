"""Whether an arm may go straight from joints to joints in a simulated scene without coming near anything."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.envs.env import Env

MARGIN = 0.01
"""Least distance of the robot's shapes from all others [m]."""
STEP = 0.03
"""Largest change of a joint between two checks [rad]."""


class FreePath:
    """Checks paths of one arm; everything else stays where it is at the time.

    The shapes are those that collide in the scene. What is near at the start of a path may stay so.
    """

    def __init__(self, env: Env, robot: str) -> None:
        """Use the scene of an environment.

        Args:
            env: A simulated environment of one copy.
            robot: Name of the robot.
        """
        found = next(one for one in env.scenario.robots if one.placement.name == robot)
        self._world = env.scenario.world
        self._qpos = found.layout.qpos
        self._model = copy.copy(self._world.model)
        self._model.geom_margin[:] = MARGIN / 2  # those of two shapes are added
        self._data = mujoco.MjData(self._model)
        body = np.arange(self._model.nbody)
        for _ in range(self._model.nbody):  # up to the arm's base, or to the world
            body = np.where(body == found.layout.base_body, body, self._model.body_parentid[body])
        self._is_robot = body[self._model.geom_bodyid] == found.layout.base_body

    def __call__(self, start: NDArray[np.float64], end: NDArray[np.float64]) -> bool:
        """Return whether the arm may go straight from joints to joints [rad], (dof,) each."""
        count = int(np.ceil(np.abs(end - start).max() / STEP)) + 1
        self._data.qpos[:] = self._world.qpos
        allowed = self._near(start)
        return all(self._near(start + (end - start) * i / count) <= allowed for i in range(1, count + 1))

    def _near(self, joints: NDArray[np.float64]) -> set[tuple[int, int]]:
        """Return the pairs of geoms that are nearer than the margin, of which one is the robot's."""
        self._data.qpos[self._qpos] = joints
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        pairs = self._data.contact.geom[: self._data.ncon]
        return {(int(a), int(b)) for a, b in pairs if self._is_robot[a] or self._is_robot[b]}
