"""Obstacles: posts that stand around an object and must not be touched."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.envs.draws import Draws
from rcs.envs.layers import Where
from rcs.sim.scene import FLOOR_HEIGHT, Scene
from rcs.sim.world import World
from rcs.spatial import xyzw_to_wxyz
from rcs.tasks.distractors import Taken
from rcs.tasks.lifting import table_height, upright

MOST = 8
"""Most obstacles in a scene."""
HALF_WIDTH, HALF_HEIGHT = 0.015, 0.175
"""Half the edges of a post at the usual size of objects [m]: higher than the flange when it grasps."""
NEAREST, FARTHEST = 0.15, 0.26
"""Distances of posts from the object at its usual size [m]: beyond an open hand, 10 cm to each side."""
BASE = 0.20
"""Distance from the origin of the scene, where a single robot stands, that stays free [m]."""
TRIES = 16
"""Places that are drawn for each; the first free one counts."""


class Obstacles:
    """Posts that stand firmly on the table.

    Every episode draws where. One for which there is no room stands on the floor behind the table. The draws come from
    streams of their own: a task starts as it does without obstacles.
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
            # Of a body with `mocap`, the place is part of the state.
            body = scene.spec.worldbody.add_body(name=name, mocap=True, pos=[*_put_away(i), FLOOR_HEIGHT + half[2]])
            body.add_geom(
                name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=half, rgba=[0.80, 0.33, 0.16, 1.0], condim=4, group=0
            )

    def bind(self, world: World) -> None:
        """Look them up, once the scene is compiled."""
        if not self.names:
            return
        self._world = world
        state = mujoco.mjtState
        self._pos = world.core.component(state.mjSTATE_MOCAP_POS.value).reshape(*world.leading, -1, 3)
        self._quat = world.core.component(state.mjSTATE_MOCAP_QUAT.value).reshape(*world.leading, -1, 4)
        self._ids = [int(world.model.body(name).mocapid[0]) for name in self.names]

    def reset(self, draws: Draws, where: Where, middle: NDArray[np.float64]) -> list[Taken]:
        """Draw the obstacles of the next episodes of some copies.

        Args:
            draws: Random numbers for exactly these copies; they are not advanced.
            where: The copies; `...` for all, or for the only one.
            middle: The object in the scene, x, y of exactly these copies, (*leading, 2) [m].

        Returns:
            What they take of the table.
        """
        if not self.names:
            return []
        streams = draws.branch("obstacles")
        half = self._scale * HALF_HEIGHT
        height = table_height(self._world)[where]
        taken: list[Taken] = []
        for i, which in enumerate(self._ids):
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
            for center, own in taken:
                dx, dy = places[..., 0] - center[..., 0:1], places[..., 1] - center[..., 1:2]
                is_free &= dx * dx + dy * dy > np.asarray(4.0 * own * own)
            first = is_free.argmax(axis=-1)[..., None, None]
            place = np.take_along_axis(places, first, axis=-2)[..., 0, :]
            has_room = is_free.any(axis=-1)
            place[..., :2] = np.where(np.expand_dims(has_room, -1), place[..., :2], _put_away(i))
            pose = upright(place, half + np.where(has_room, height, FLOOR_HEIGHT))
            self._pos[where, which, :] = pose[..., :3]
            self._quat[where, which, :] = xyzw_to_wxyz(pose[..., 3:])
            taken.append((place, self._scale * HALF_WIDTH * np.sqrt(2.0)))
        return taken


def _put_away(i: int) -> tuple[float, float]:
    """Return a free place on the floor, behind the table."""
    return (1.2 + 0.1 * (i % 4), 0.35 + 0.1 * (i // 4))
