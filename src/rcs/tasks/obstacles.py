"""Obstacles: posts that stand around an object and must not be touched."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.layers import CopyIndex
from rcs.sim.robot import SimRobot
from rcs.sim.scene import FLOOR_HEIGHT, Scene
from rcs.sim.world import World
from rcs.tasks.distractors import Circle, are_apart, first_free
from rcs.tasks.lifting import table_height, upright
from rcs.tasks.table_task import FreeBody

MOST = 8
"""Most obstacles in a scene."""
HALF_WIDTH, HALF_HEIGHT = 0.015, 0.175
"""Half the edges of a post at the usual size of objects [m]: higher than the flange when it grasps."""
NEAREST, FARTHEST = 0.15, 0.26
"""Distances of posts from the object at its usual size [m]: beyond an open hand, 10 cm to each side."""
BASE = 0.20
"""Distance from the origin of the scene, where a single robot stands, that stays free [m]."""
HOME = 0.03
"""Distance that stays free around a robot at home [m]."""
TRIES = 16
"""Places that are drawn for each; the first free one counts."""


class Obstacles:
    """Posts that stand firmly on the table.

    Every episode draws where, clear of the object and of the robot at home. One for which there is no room stands on
    the floor behind the table. The draws come from streams of their own: a task starts as it does without obstacles.
    """

    def __init__(self, count: int, *, scale: float = 1.0) -> None:
        """Plan some obstacles.

        Args:
            count: How many, up to `MOST`.
            scale: Factor on their extents and distances, such as an area's `object_scale`.
        """
        self.names = [f"obstacle {i}" for i in range(count)]
        """Names of their bodies and geoms."""
        self._scale = scale

    def furnish(self, scene: Scene) -> None:
        """Add them to a scene before it is compiled."""
        half = self._scale * np.array([HALF_WIDTH, HALF_WIDTH, HALF_HEIGHT])
        for i, name in enumerate(self.names):
            # The pose of a body with `mocap` is part of the state.
            body = scene.spec.worldbody.add_body(name=name, mocap=True, pos=[*_put_away(i), FLOOR_HEIGHT + half[2]])
            body.add_geom(
                name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=half, rgba=[0.80, 0.33, 0.16, 1.0], condim=4, group=0
            )

    def bind(self, world: World, robot: SimRobot) -> None:
        """Look them up, once the scene is compiled, and where the robot stands at home."""
        if not self.names:
            return
        self._world = world
        self._home = _footprint(world.model, robot, below=2.0 * self._scale * HALF_HEIGHT)
        self._bodies = [FreeBody(world, name) for name in self.names]

    def reset(self, random: EpisodeRandom, where: CopyIndex, middle: NDArray[np.float64]) -> list[Circle]:
        """Draw the obstacles of the next episodes of some copies.

        Args:
            random: Random numbers for exactly these copies; they are not advanced.
            where: The copies; `...` for all, or for the only one.
            middle: The object in the scene, x, y of exactly these copies, (*leading, 2) [m].

        Returns:
            The circles that they take on the table.
        """
        if not self.names:
            return []
        streams = random.branch("obstacles")
        half = self._scale * HALF_HEIGHT
        height = table_height(self._world)[where]
        occupied: list[Circle] = []
        for i, body in enumerate(self._bodies):
            # Numbers of one shape for all copies, whatever is free.
            drawn = streams.uniform(np.zeros((TRIES, 3)), np.ones((TRIES, 3)))
            angle = 2.0 * np.pi * drawn[..., 0]
            radius = self._scale * (NEAREST + (FARTHEST - NEAREST) * drawn[..., 1])
            places = np.stack(
                [
                    middle[..., 0:1] + radius * np.cos(angle),
                    middle[..., 1:2] + radius * np.sin(angle),
                    2.0 * np.pi * drawn[..., 2],
                ],
                axis=-1,
            )
            is_free = places[..., 0] ** 2 + places[..., 1] ** 2 > BASE * BASE
            is_free &= self._leaves_home(places)
            for center, own in occupied:
                is_free &= are_apart(places, center, np.asarray(2.0 * own))
            place, has_room = first_free(places, is_free, _put_away(i))
            body.place(upright(place, half + np.where(has_room, height, FLOOR_HEIGHT)), where)
            occupied.append((place, self._scale * HALF_WIDTH * np.sqrt(2.0)))
        return occupied

    def _leaves_home(self, places: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return whether the robot at home is not near posts at places, x, y first."""
        start, along, radius = self._home
        away = places[..., None, :2] - start
        share = (away * along).sum(-1) / np.maximum((along * along).sum(-1), 1e-12)
        apart = np.linalg.norm(away - np.clip(share, 0.0, 1.0)[..., None] * along, axis=-1)
        return (apart > radius + self._scale * HALF_WIDTH * np.sqrt(2.0) + HOME).all(axis=-1)


def _footprint(
    model: mujoco.MjModel, robot: SimRobot, below: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the parts of a robot at home that are below a height above its base [m], seen from above.

    Returns:
        Starts of lines, (n, 2), their extents, (n, 2), and the radius of the robot around each, (n,) [m].
    """
    data, layout, placement = mujoco.MjData(model), robot.layout, robot.placement
    data.qpos[layout.qpos] = placement.arm.home
    if placement.gripper is not None:
        data.qpos[layout.finger_qpos] = placement.gripper.joint_open
    mujoco.mj_kinematics(model, data)
    body = np.arange(model.nbody)
    for _ in range(model.nbody):  # up to the base, or to the world
        body = np.where(body == layout.base_body, body, model.body_parentid[body])
    geoms = np.flatnonzero((body[model.geom_bodyid] == layout.base_body) & (model.geom_contype > 0))
    middle, half = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
    turn = data.geom_xmat[geoms].reshape(-1, 3, 3)
    middle = data.geom_xpos[geoms] + np.einsum("gij,gj->gi", turn, middle)
    longest = half.argmax(axis=1)
    number = np.arange(len(geoms))
    along = turn[number, :, longest] * half[number, longest, None]
    across = half.copy()
    across[number, longest] = 0.0
    radius = np.linalg.norm(across, axis=1)
    low = middle[:, 2] - np.abs(along[:, 2]) - radius < data.xpos[layout.base_body, 2] + below
    return (middle - along)[low, :2], 2.0 * along[low, :2], radius[low]


def _put_away(i: int) -> tuple[float, float]:
    """Return a free place on the floor, behind the table."""
    return (1.2 + 0.1 * (i % 4), 0.35 + 0.1 * (i // 4))
