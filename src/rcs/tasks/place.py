"""Place: carry a cuboid to a mark on the table, set it down there and let go of it."""

from __future__ import annotations

from typing import Any

import mujoco
from numpy.typing import NDArray
from rcs_data.options import Positive

from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.layers import CopyIndex
from rcs.envs.task import Judgement
from rcs.sim.robot import SimRobot
from rcs.sim.scene import TABLE, Scene
from rcs.sim.world import World
from rcs.tasks.lifting import add_box, table_height, upright
from rcs.tasks.pick_cuboid import CUBOID, MASS, SIZE
from rcs.tasks.setting_down import Delivery, RestOptions
from rcs.tasks.table_task import TableTask

MARK = "mark"
RADIUS = 0.045
"""Radius of the mark [m]: a cuboid on it leaves its edge in sight."""
RINGS = ((1.0, (0.80, 0.12, 0.10)), (0.66, (0.95, 0.95, 0.93)), (0.33, (0.80, 0.12, 0.10)))
"""Rings of the mark, from the outermost: share of its radius, and colour."""
THICKNESS = 0.0004
"""How far each ring lies above the one around it [m], so that it is seen; nothing touches them."""
APART = 0.12
"""Least distance from the cuboid to the mark at the start [m]: neither covers the other."""


class PlaceOptions(RestOptions):
    """Options of Place."""

    tolerance: Positive = 0.02
    """Largest distance of the cuboid's middle from that of the mark [m]."""


class Place(TableTask):
    """Carry a cuboid to a mark on the table, set it down there and let go of it.

    It is a success when the cuboid lies within 2 cm of the mark's middle, flat, on the table, and touched by nothing
    else, and has been at rest there for half a second. The gripper must have lifted it off the table before, and must
    have let go of it within 3 cm of where it belongs: a cuboid that is pushed, dropped or thrown there does not count.
    This is judged at the end of each step.

    Progress, of which the reward is made, has nine parts: one each for reaching, lifting, setting down and letting go,
    two for grasping, and three for carrying; those of what is held count by how upright the cuboid is.
    """

    memory = ("_delivery",)
    names, marks = (CUBOID,), (MARK,)
    instruction = "put the green cuboid on the red mark"
    expert = "PlaceExpert"
    Options = PlaceOptions
    options: PlaceOptions

    @property
    def edges(self) -> tuple[float, ...]:
        """Edges of the cuboid along its x, y, z [m]; they may vary between episodes."""
        return tuple(self.area.object_scale * edge for edge in SIZE)

    def furnish(self, scene: Scene) -> None:
        """Add a table, the mark and the cuboid."""
        scene.add_table()
        scale = self.area.object_scale
        add_mark(scene, MARK, self.area.center, radius=scale * RADIUS)
        add_box(scene, CUBOID, self.area.center, edges=self.edges, mass=MASS * scale**3, rgb=(0.10, 0.55, 0.20))

    def bind(self, world: World, robots: list[SimRobot]) -> None:
        """Register poses and forces for readout.

        Raises:
            InvalidSetup: There is not exactly one robot, or it has no gripper.
        """
        super().bind(world, robots)
        self._delivery = Delivery(world, robots, CUBOID, on=TABLE, at=MARK, rest_time=self.options.rest_time)
        self._geom = int(world.model.geom(CUBOID).id)

    def reset(self, random: EpisodeRandom, where: CopyIndex) -> None:
        """Put the cuboid and the mark at random places, the cuboid at any yaw."""
        height = self._world.field("geom_size")[..., self._geom, 2]  # varies between episodes
        table = table_height(self._world)[where]
        place = self.area.draw_place(random)
        self.bodies[CUBOID].place(upright(place, table + height[where]), where)
        other = self.area.draw_apart(random, place, APART * self.area.object_scale)
        other[..., 2] = 0.0  # it is round
        self.bodies[MARK].place(upright(other, table), where)
        self._delivery.reset(where, height)

    def evaluate(self) -> Judgement:
        """Judge where the cuboid is and whether it was set down there."""
        return self._delivery.judge(self.options.tolerance)

    def seen(self) -> dict[str, NDArray[Any]]:
        """Return the poses of cuboid and goal."""
        return self._delivery.seen()


def add_mark(scene: Scene, name: str, place: tuple[float, float], *, radius: float) -> None:
    """Add a round mark on the table, red and white, that nothing touches and only the task places.

    Args:
        scene: The scene, before it is compiled.
        name: Name of its body.
        place: x, y of its middle in the scene [m].
        radius: Its radius [m].
    """
    body = scene.spec.worldbody.add_body(name=name, pos=[*place, 0.0], mocap=True)
    for i, (share, rgb) in enumerate(RINGS):
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[share * radius, (i + 1) * THICKNESS / 2, 0.0],
            pos=[0.0, 0.0, (i + 1) * THICKNESS / 2],
            rgba=[*rgb, 1.0],
            contype=0,
            conaffinity=0,
            group=0,
        )
