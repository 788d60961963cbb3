"""Objects in a scene besides those of its task."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.layers import CopyIndex
from rcs.envs.task import Area, Circle, Task
from rcs.sim.model_rows import ObjectParts
from rcs.sim.scene import Scene
from rcs.sim.world import World

ROOM = 0.07
"""Room around a task's object for the fingers that grasp it [m]: those of a Franka Hand end 6 cm from its middle."""


class Clutter(Protocol):
    """Objects that do not belong to the task."""

    def furnish(self, scene: Scene) -> None:
        """Add them to a scene before it is compiled."""
        ...

    def bind(self, world: World) -> None:
        """Look them up, once the scene is compiled."""
        ...

    def reset(
        self, random: EpisodeRandom, where: CopyIndex, area: Area, occupied: Iterable[Circle] = ()
    ) -> list[Circle]:
        """Put them somewhere in the next episodes of some copies.

        Args:
            random: Random numbers for exactly these copies; they are not advanced.
            where: The copies; `...` for all, or for the only one.
            area: Where they may lie, with their middles.
            occupied: Circles that stay free, of exactly these copies.

        Returns:
            The circles that they take on the table.
        """
        ...


class ObjectCircles:
    """The circles on the table that a task's objects take up, with room for a gripper."""

    def __init__(self, world: World, task: Task) -> None:
        """Use the objects of a task that is bound to the world, whose poses the task gives."""
        self._world = world
        self._task = task
        self._parts: dict[str, ObjectParts] = {}

    def at(self, where: CopyIndex) -> list[Circle]:
        """Return the present circles of some copies, as `Clutter.reset` takes them; the world is refreshed."""
        poses = self._task.object_poses()
        if not self._parts:
            self._parts = {name: ObjectParts(self._world, name) for name in poses}
        return [(pose[where][..., :2], self._radius(self._parts[name])[where] + ROOM) for name, pose in poses.items()]

    def _radius(self, parts: ObjectParts) -> NDArray[np.float64]:
        """Return the radius of a circle around an object's root from above, (*leading,)."""
        field = self._world.field
        radius = np.zeros(self._world.leading)
        for geom in parts.geoms:
            x, y = field("geom_pos")[..., geom, 0], field("geom_pos")[..., geom, 1]
            radius = np.maximum(radius, np.sqrt(x * x + y * y) + field("geom_rbound")[..., geom])
        for body in parts.bodies[parts.bodies != parts.root]:  # such as the nodes of a soft object
            x, y = field("body_pos")[..., body, 0], field("body_pos")[..., body, 1]
            radius = np.maximum(radius, np.sqrt(x * x + y * y))
        return radius
