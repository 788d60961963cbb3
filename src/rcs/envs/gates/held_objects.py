"""Objects that end effectors hold by the geometry of a scene: those that two of its bodies touch."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.sim.scene import RobotPlacement
from rcs.spatial import Pose

TOUCH = 1e-3
"""Distance up to which a body touches an object [m]: soft fingers and contacts give way by less."""


class HeldObjects:
    """Looks for held objects in a model."""

    def __init__(self, model: mujoco.MjModel, objects: Iterable[str], robots: Iterable[RobotPlacement]) -> None:
        """Look the bodies up.

        Args:
            model: The scene; its geometry may change later.
            objects: Bodies that may be held; those without a free joint never are.
            robots: Robots that may hold them.
        """
        self._model, self._data = model, mujoco.MjData(model)
        bodies = [model.body(name) for name in objects]
        free = mujoco.mjtJoint.mjJNT_FREE
        self._objects = [b.id for b in bodies if b.jntnum[0] == 1 and model.jnt_type[b.jntadr[0]] == free]
        owners = [model.body(body).name for body in model.geom_bodyid]
        self._hands = [
            np.array(
                [g for g, name in enumerate(owners) if name.startswith(robot.gripper_prefix) and self._collides(g)]
            )
            for robot in robots
            if robot.end_effector is not None
        ]
        self._geoms = {body: np.flatnonzero(model.geom_bodyid == body) for body in self._objects}

    def _collides(self, geom: int) -> bool:
        return bool(self._model.geom_contype[geom] or self._model.geom_conaffinity[geom])

    def find(self, qpos: NDArray[np.float64]) -> dict[int, tuple[int, Pose]]:
        """Return what is held in a state (nq,): by body id, the body that holds the object and its pose in that."""
        held: dict[int, tuple[int, Pose]] = {}
        if not self._objects:
            return held
        model, data = self._model, self._data
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        for body in self._objects:
            for hand in self._hands:
                fingers = {int(model.geom_bodyid[b]) for a in self._geoms[body] for b in self._near(int(a), hand)}
                if len(fingers) > 1:
                    root = min(int(model.geom_bodyid[geom]) for geom in hand)  # parents come first
                    held[body] = root, self._pose(root).inverse() * self._pose(body)
                    break
        return held

    def _near(self, geom: int, others: NDArray[np.intp]) -> list[int]:
        """Return which geoms touch one."""
        model, data = self._model, self._data
        reach = model.geom_rbound[geom] + model.geom_rbound[others] + TOUCH
        close = others[np.linalg.norm(data.geom_xpos[others] - data.geom_xpos[geom], axis=1) < reach]
        return [
            int(other) for other in close if mujoco.mj_geomDistance(model, data, geom, int(other), TOUCH, None) < TOUCH
        ]

    def _pose(self, body: int) -> Pose:
        w, x, y, z = self._data.xquat[body]
        return Pose(self._data.xpos[body], [x, y, z, w])


def changed(
    before: dict[int, tuple[int, Pose]], now: dict[int, tuple[int, Pose]], distance: float, turn: float
) -> Collection[int]:
    """Return the objects that are held anew, by something else, or that have slipped by more than that [m, rad]."""

    def is_same(body: int) -> bool:
        (holder, pose), (other, moved) = before[body], now[body]
        return holder == other and pose.distance_to(moved) <= distance and pose.angle_to(moved) <= turn

    return [body for body in now if body not in before or not is_same(body)]
