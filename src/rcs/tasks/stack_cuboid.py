"""StackCuboid: put one cuboid on another."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.layers import CopyIndex
from rcs.envs.task import Judgement
from rcs.sim.robot import SimRobot
from rcs.sim.scene import TABLE, Scene
from rcs.sim.world import World
from rcs.tasks.holding import all_but
from rcs.tasks.lifting import add_box, table_height, upright
from rcs.tasks.pick_cuboid import CUBOID, MASS, SIZE
from rcs.tasks.setting_down import Delivery, RestOptions, is_flat
from rcs.tasks.table_task import TableTask

BLOCK = "block"
NAMES = CUBOID, BLOCK
COLOURS = {CUBOID: (0.10, 0.55, 0.20), BLOCK: (0.12, 0.30, 0.62)}
APART = 0.16
"""Least distance between the cuboids at the start [m]: an open gripper fits around one without touching the other."""


class StackCuboid(TableTask):
    """Put the green cuboid on the blue block, a cuboid of the same size, and let go of it.

    It is a success when the cuboid lies on the block, flat, and touched by nothing else, and has been at rest there for
    half a second, while the block lies flat and touches nothing but the cuboid and the table. The gripper must have
    lifted the cuboid off the table before, and must have let go of it within 3 cm of the place right above the block: a
    cuboid that is dropped or thrown there does not count. This is judged at the end of each step.

    Progress, of which the reward is made, has nine parts: one each for reaching, lifting, setting down and letting go,
    two for grasping, and three for carrying; those of what is held count by how upright the cuboid is.
    """

    memory = ("_delivery",)
    names = NAMES
    instruction = "put the green cuboid on the blue block"
    expert = "StackExpert"
    Options = RestOptions
    options: RestOptions

    def furnish(self, scene: Scene) -> None:
        """Add a table and both cuboids."""
        scene.add_table()
        scale = self.area.object_scale
        edges = [scale * edge for edge in SIZE]
        x, y = self.area.center
        for i, name in enumerate(NAMES):
            place = (x, y + i * APART)
            add_box(scene, name, place, edges=edges, mass=MASS * scale**3, rgb=COLOURS[name])

    def bind(self, world: World, robots: list[SimRobot]) -> None:
        """Register poses and forces for readout.

        Raises:
            InvalidSetup: There is not exactly one robot, or it has no gripper.
        """
        super().bind(world, robots)
        self._delivery = Delivery(world, robots, CUBOID, on=BLOCK, at=BLOCK, rest_time=self.options.rest_time)
        self._block_touched = world.core.read_force(all_but(world, TABLE, *NAMES), world.geom_flags([BLOCK]))
        self._geoms = [int(world.model.geom(name).id) for name in NAMES]

    def reset(self, random: EpisodeRandom, where: CopyIndex) -> None:
        """Put both cuboids at random places and yaws, apart from each other."""
        half_heights = self._world.field("geom_size")[..., self._geoms, 2]  # they vary between episodes
        heights = table_height(self._world)[..., None] + half_heights
        place = self.area.draw_place(random)
        places = place, self.area.draw_apart(random, place, APART * self.area.object_scale)
        for i, name in enumerate(NAMES):
            self.bodies[name].place(upright(places[i], heights[..., i][where]), where)
        self._delivery.reset(where, half_heights[..., 0] + half_heights[..., 1])

    def evaluate(self) -> Judgement:
        """Judge where the cuboid is and whether it was set down there."""
        is_ready = is_flat(self.poses_of(BLOCK)) & (self._world.forces[..., self._block_touched] == 0.0)
        return self._delivery.judge(np.inf, is_ready)

    def seen(self) -> dict[str, NDArray[Any]]:
        """Return the poses of cuboid and goal."""
        return self._delivery.seen()
