"""Distractors: objects of random sizes, colours and places that do not matter to a task."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.layers import CopyIndex
from rcs.envs.task import Area
from rcs.sim.model_rows import ModelRows
from rcs.sim.scene import FLOOR_HEIGHT, Scene
from rcs.sim.world import World
from rcs.tasks.lifting import table_height, upright
from rcs.tasks.sizes import SizedBodies
from rcs.tasks.table_task import FreeBody

Circle = tuple[NDArray[np.float64], NDArray[np.float64] | float]
"""A circle on the table that stays free: its middle in the scene, (*leading, 2) or longer [m], and radius [m]."""

MOST = 16
"""Most distractors in a scene."""
HALF_LOW, HALF_HIGH = (0.012, 0.012, 0.010), (0.028, 0.028, 0.032)
"""Half the extents along x, y, z [m]: from coins to cans. The tallest end below the palm of a gripper that grasps."""
DENSITY = 450.0
"""Density of objects printed in PLA with a usual infill, about that of Pick-Cuboid's cuboid [kg/m³]."""
GAP = 0.01
"""Least free space around a distractor [m]."""
TRIES = 24
"""Places that are drawn for each distractor; the first free one counts."""
GREENS = (70.0, 180.0)
"""Hues in degrees that no distractor has, so that the only green object of a scene is a task's."""


class Distractors:
    """Boxes and cylinders in turn, which lie on the table without touching anything.

    Every episode draws size, colour, place and yaw of each. One for which there is no room lies on the floor. The draws
    come from streams of their own: a task starts as it does without distractors.
    """

    def __init__(self, count: int, *, scale: float = 1.0) -> None:
        """Plan some distractors.

        Args:
            count: How many, up to `MOST`.
            scale: Factor on their extents, such as an area's `object_scale`.
        """
        self.names = [f"distractor {i}" for i in range(count)]
        """Names of their bodies, joints and geoms."""
        self._scale = scale

    def furnish(self, scene: Scene) -> None:
        """Add them to a scene before it is compiled."""
        half = self._scale * (np.array(HALF_LOW) + HALF_HIGH) / 2
        for i, name in enumerate(self.names):
            is_round = i % 2 == 1
            body = scene.spec.worldbody.add_body(name=name, pos=[*_put_away(i), FLOOR_HEIGHT + half[2]])
            body.add_freejoint(name=name)
            body.add_geom(
                name=name,
                type=mujoco.mjtGeom.mjGEOM_CYLINDER if is_round else mujoco.mjtGeom.mjGEOM_BOX,
                size=[half[0], half[2], 0.0] if is_round else half,
                density=DENSITY,
                friction=[1.0, 0.01, 0.0001],
                condim=4,
                solref=[0.01, 1.0],
                group=0,
            )

    def bind(self, world: World) -> None:
        """Look them up, once the scene is compiled."""
        if not self.names:
            return
        self._world = world
        self._bodies = [FreeBody(world, name) for name in self.names]
        self._sizes = SizedBodies(world, self.names)
        self._colours = ModelRows(world, "geom_rgba", [world.model.geom(name).id for name in self.names])

    def reset(
        self,
        random: EpisodeRandom,
        where: CopyIndex,
        area: Area,
        occupied: Iterable[Circle] = (),
        around: Circle | None = None,
    ) -> None:
        """Draw the distractors of the next episodes of some copies.

        Args:
            random: Random numbers for exactly these copies; they are not advanced.
            where: The copies; `...` for all, or for the only one.
            area: Where distractors lie, with their middles.
            occupied: Circles that other objects take, of exactly these copies.
            around: Part of the area in which they lie, a square around a circle; None for all of it.
        """
        if not self.names:
            return
        streams, count = random.branch("distractors"), len(self.names)
        half = self._scale * streams.uniform(np.tile(HALF_LOW, (count, 1)), np.tile(HALF_HIGH, (count, 1)))
        half[..., 1::2, 1] = half[..., 1::2, 0]  # cylinders are round
        self._sizes.write(half, where, DENSITY)
        shades = streams.uniform(np.zeros((count, 3)), np.ones((count, 3)))
        self._colours.write(_colours(shades), None if where is ... else where)
        low, high = _corners(area, around)
        circles = list(occupied)
        table = table_height(self._world)[where]
        for i, body in enumerate(self._bodies):
            x, y, z = (half[..., i, axis] for axis in range(3))
            radius = x if i % 2 else np.sqrt(x * x + y * y)
            # Numbers of one shape for all copies, whatever their bounds are.
            places = streams.uniform(np.zeros((TRIES, 3)), np.ones((TRIES, 3)))
            places[..., :2] = low[..., None, :] + (high - low)[..., None, :] * places[..., :2]
            places[..., 2] = np.pi * (2.0 * places[..., 2] - 1.0)
            is_free = np.ones(places.shape[:-1], np.bool_)
            for center, own in circles:
                is_free &= are_apart(places, center, np.asarray(radius + own + GAP)[..., None])
            place, has_room = first_free(places, is_free, _put_away(i))
            body.place(upright(place, z + np.where(has_room, table, FLOOR_HEIGHT)), where)
            circles.append((place, radius))


def are_apart(
    places: NDArray[np.float64], center: NDArray[np.float64], distance: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return which places are farther than a distance from a centre, (*leading, tries).

    Args:
        places: x, y first [m], (*leading, tries, 3).
        center: x, y first [m], (*leading, 2) or longer.
        distance: The distance [m].
    """
    dx, dy = places[..., 0] - center[..., 0:1], places[..., 1] - center[..., 1:2]
    return dx * dx + dy * dy > distance * distance


def first_free(
    places: NDArray[np.float64], is_free: NDArray[np.bool_], away: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the first free place of each copy, (*leading, 3), and whether there is one; otherwise it is `away`."""
    first = is_free.argmax(axis=-1)[..., None, None]
    place = np.take_along_axis(places, first, axis=-2)[..., 0, :]
    has_room: Any = is_free.any(axis=-1)
    place[..., :2] = np.where(np.expand_dims(has_room, -1), place[..., :2], away)
    return place, has_room


def _corners(area: Area, around: Circle | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lowest and highest x, y of distractors in the scene [m], (2,) or (*leading, 2)."""
    center, half = np.array(area.center), np.array(area.size) / 2
    low, high = center - half, center + half
    if around is None:
        return low, high
    middle, reach = around[0][..., :2], np.expand_dims(np.asarray(around[1]), -1)
    return np.clip(middle - reach, low, high), np.clip(middle + reach, low, high)


def _put_away(i: int) -> tuple[float, float]:
    """Return a free place on the floor, behind the table."""
    return (1.2 + 0.1 * (i % 4), -0.15 + 0.1 * (i // 4))


def _colours(drawn: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return strong and pale colours that are not green, (..., 4), from three numbers 0 … 1 each."""
    low, high = GREENS
    hue = np.mod(high + drawn[..., 0] * (360.0 - (high - low)), 360.0) / 60.0
    value, strength = 0.35 + 0.55 * drawn[..., 1], 0.55 + 0.40 * drawn[..., 2]
    rgba = np.ones((*drawn.shape[:-1], 4), np.float32)
    for channel, offset in enumerate((5.0, 3.0, 1.0)):  # HSV to RGB (Smith 1978), without branches
        k = np.mod(offset + hue, 6.0)
        rgba[..., channel] = value * (1.0 - strength * np.clip(np.minimum(k, 4.0 - k), 0.0, 1.0))
    return rgba
