"""Additions that make a task harder: distractors and obstacles of random places, and objects of random sizes."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.layers import CopyIndex
from rcs.envs.task import Area, Circle
from rcs.sim.model_rows import ModelRows
from rcs.sim.robot import SimRobot
from rcs.sim.scene import FLOOR_HEIGHT, Scene
from rcs.sim.world import World
from rcs.tasks.lifting import table_height, upright
from rcs.tasks.table_task import FreeBody

Places = NDArray[np.float64]

MOST_DISTRACTORS = 16
"""Most distractors in a scene."""
HALF_LOW, HALF_HIGH = (0.012, 0.012, 0.010), (0.028, 0.028, 0.032)
"""Half the extents of a distractor along x, y, z [m]: from coins to cans. The tallest end below the palm of a gripper
that grasps."""
DENSITY = 450.0
"""Density of objects printed in PLA with a usual infill, about that of PickCuboid's cuboid [kg/m³]."""
GAP = 0.01
"""Least free space around a distractor [m]."""
GREENS = (70.0, 180.0)
"""Hues in degrees that no distractor has, so that the only green object of a scene is a task's."""

MOST_OBSTACLES = 8
"""Most obstacles in a scene."""
HALF_WIDTH, HALF_HEIGHT = 0.015, 0.175
"""Half the edges of a post at the usual size of objects [m]: higher than the flange when it grasps."""
NEAREST, FARTHEST = 0.15, 0.26
"""Distances of posts from the object at its usual size [m]: beyond an open hand, 10 cm to each side."""
BASE = 0.20
"""Distance of posts from the origin of the scene, where a single robot stands [m]."""
HOME = 0.03
"""Distance that stays free around a robot at home [m]."""


class _Scattered:
    """Bodies that lie about, each at the first free one of some drawn places.

    The draws come from streams of their own: a task starts as it does without them.
    """

    kind: ClassVar[str]
    """Name of the bodies, before their numbers, and of their streams."""
    tries: ClassVar[int]
    """Places that are drawn for each; the first free one counts."""
    row: ClassVar[float]
    """y of the first one that finds no room, on the floor behind the table [m]."""

    def __init__(self, count: int, *, scale: float = 1.0) -> None:
        """Plan some bodies.

        Args:
            count: How many.
            scale: Factor on their extents and distances, such as an area's `object_scale`.
        """
        self._numbers = list(range(count))
        self._scale = scale

    @property
    def names(self) -> list[str]:
        """Names of their bodies and geoms."""
        return [f"{self.kind} {number}" for number in self._numbers]

    def _look_up(self, world: World) -> None:
        self._world = world
        self._bodies = [FreeBody(world, name) for name in self.names]

    def _away(self, i: int) -> tuple[float, float]:
        """Return a free place on the floor, behind the table."""
        number = self._numbers[i]
        return (1.2 + 0.1 * (number % 4) + 0.4 * (number // 16), self.row + 0.1 * (number % 16 // 4))

    def _draw(self, streams: EpisodeRandom) -> Places:
        """Return numbers 0 … 1 of one shape for all copies, whatever their bounds are, (*leading, tries, 3)."""
        return streams.uniform(np.zeros((self.tries, 3)), np.ones((self.tries, 3)))

    def _put(self, i: int, places: Places, is_free: NDArray[np.bool_], half_height: Any, where: CopyIndex) -> Places:
        """Put a body at the first free place of each copy, or on the floor; return where, x, y and yaw."""
        first = is_free.argmax(axis=-1)[..., None, None]
        place = np.take_along_axis(places, first, axis=-2)[..., 0, :]
        has_room: Any = is_free.any(axis=-1)
        place[..., :2] = np.where(np.expand_dims(has_room, -1), place[..., :2], self._away(i))
        floor = np.where(has_room, table_height(self._world)[where], FLOOR_HEIGHT)
        self._bodies[i].place(upright(place, half_height + floor), where)
        return place


class Distractors(_Scattered):
    """Boxes and cylinders in turn, up to `MOST_DISTRACTORS`, which lie on the table without touching anything.

    Every episode draws size, colour, place and yaw of each. One for which there is no room lies on the floor.
    """

    kind, tries, row = "distractor", 24, -0.15

    def furnish(self, scene: Scene) -> None:
        """Add them to a scene before it is compiled, numbered after those that it has already."""
        taken = {body.name for body in scene.spec.bodies}
        free = (number for number in itertools.count() if f"{self.kind} {number}" not in taken)
        self._numbers = list(itertools.islice(free, len(self._numbers)))
        half = self._scale * (np.array(HALF_LOW) + HALF_HIGH) / 2
        for i, name in enumerate(self.names):
            is_round = i % 2 == 1
            body = scene.spec.worldbody.add_body(name=name, pos=[*self._away(i), FLOOR_HEIGHT + half[2]])
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
        self._look_up(world)
        self._sizes = SizedBodies(world, self.names)
        self._colours = ModelRows(world, "geom_rgba", [world.model.geom(name).id for name in self.names])

    def reset(
        self,
        random: EpisodeRandom,
        where: CopyIndex,
        area: Area,
        occupied: Iterable[Circle] = (),
        around: Circle | None = None,
    ) -> list[Circle]:
        """Draw the distractors of the next episodes of some copies.

        Args:
            random: Random numbers for exactly these copies; they are not advanced.
            where: The copies; `...` for all, or for the only one.
            area: Where distractors lie, with their middles.
            occupied: Circles that other objects take, of exactly these copies.
            around: Part of the area in which they lie, a square around a circle; None for all of it.

        Returns:
            The circles that they take on the table.
        """
        if not self.names:
            return []
        streams, count = random.branch("distractors"), len(self.names)
        half = self._scale * streams.uniform(np.tile(HALF_LOW, (count, 1)), np.tile(HALF_HIGH, (count, 1)))
        half[..., 1::2, 1] = half[..., 1::2, 0]  # cylinders are round
        self._sizes.write(half, where, DENSITY)
        shades = streams.uniform(np.zeros((count, 3)), np.ones((count, 3)))
        self._colours.write(_colours(shades), None if where is ... else where)
        low, high = _corners(area, around)
        others = list(occupied)
        circles: list[Circle] = []
        for i in range(count):
            x, y, z = (half[..., i, axis] for axis in range(3))
            radius = x if i % 2 else np.sqrt(x * x + y * y)
            places = self._draw(streams)
            places[..., :2] = low[..., None, :] + (high - low)[..., None, :] * places[..., :2]
            places[..., 2] = np.pi * (2.0 * places[..., 2] - 1.0)
            is_free = np.ones(places.shape[:-1], np.bool_)
            for center, own in [*others, *circles]:
                is_free &= _are_apart(places, center, np.asarray(radius + own + GAP)[..., None])
            circles.append((self._put(i, places, is_free, z, where), radius))
        return circles


class Obstacles(_Scattered):
    """Posts, up to `MOST_OBSTACLES`, that stand firmly on the table around an object and must not be touched.

    Every episode draws where, clear of the object and of the robot at home. One for which there is no room stands on
    the floor behind the table.
    """

    kind, tries, row = "obstacle", 16, 0.35

    def furnish(self, scene: Scene) -> None:
        """Add them to a scene before it is compiled."""
        half = self._scale * np.array([HALF_WIDTH, HALF_WIDTH, HALF_HEIGHT])
        for i, name in enumerate(self.names):
            # The pose of a body with `mocap` is part of the state.
            body = scene.spec.worldbody.add_body(name=name, mocap=True, pos=[*self._away(i), FLOOR_HEIGHT + half[2]])
            body.add_geom(
                name=name, type=mujoco.mjtGeom.mjGEOM_BOX, size=half, rgba=[0.80, 0.33, 0.16, 1.0], condim=4, group=0
            )

    def bind(self, world: World, robot: SimRobot) -> None:
        """Look them up, once the scene is compiled, and where the robot stands at home."""
        if not self.names:
            return
        self._look_up(world)
        self._home = _footprint(world.model, robot, below=2.0 * self._scale * HALF_HEIGHT)

    def reset(self, random: EpisodeRandom, where: CopyIndex, middle: Places) -> list[Circle]:
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
        occupied: list[Circle] = []
        for i in range(len(self.names)):
            drawn = self._draw(streams)
            angle = 2.0 * np.pi * drawn[..., 0]
            radius = self._scale * (NEAREST + (FARTHEST - NEAREST) * drawn[..., 1])
            x, y = middle[..., 0:1] + radius * np.cos(angle), middle[..., 1:2] + radius * np.sin(angle)
            places = np.stack([x, y, 2.0 * np.pi * drawn[..., 2]], axis=-1)
            is_free = (x**2 + y**2 > BASE * BASE) & self._leaves_home(places)
            for center, own in occupied:
                is_free &= _are_apart(places, center, np.asarray(2.0 * own))
            place = self._put(i, places, is_free, self._scale * HALF_HEIGHT, where)
            occupied.append((place, self._scale * HALF_WIDTH * np.sqrt(2.0)))
        return occupied

    def _leaves_home(self, places: Places) -> NDArray[np.bool_]:
        """Return whether the robot at home is not near posts at places, x, y first."""
        start, along, radius = self._home
        away = places[..., None, :2] - start
        share = (away * along).sum(-1) / np.maximum((along * along).sum(-1), 1e-12)
        apart = np.linalg.norm(away - np.clip(share, 0.0, 1.0)[..., None] * along, axis=-1)
        return (apart > radius + self._scale * HALF_WIDTH * np.sqrt(2.0) + HOME).all(axis=-1)


def _are_apart(places: Places, center: Places, distance: Places) -> NDArray[np.bool_]:
    """Return which places (*leading, tries, 3) are farther than a distance from a centre (*leading, 2 or more) [m]."""
    dx, dy = places[..., 0] - center[..., 0:1], places[..., 1] - center[..., 1:2]
    return dx * dx + dy * dy > distance * distance


def _corners(area: Area, around: Circle | None) -> tuple[Places, Places]:
    """Return the lowest and highest x, y of distractors in the scene [m], (2,) or (*leading, 2)."""
    center, half = np.array(area.center), np.array(area.size) / 2
    low, high = center - half, center + half
    if around is None:
        return low, high
    middle, reach = around[0][..., :2], np.expand_dims(np.asarray(around[1]), -1)
    return np.clip(middle - reach, low, high), np.clip(middle + reach, low, high)


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


def _footprint(model: mujoco.MjModel, robot: SimRobot, below: float) -> tuple[Places, Places, NDArray[np.float64]]:
    """Return the parts of a robot at home that are below a height above its base [m], seen from above.

    Returns:
        Starts of lines, (n, 2), their extents, (n, 2), and the radius of the robot around each, (n,) [m].
    """
    data, layout, placement = mujoco.MjData(model), robot.layout, robot.placement
    data.qpos[layout.qpos] = placement.arm.home
    if placement.gripper is not None:
        data.qpos[layout.finger_qpos] = placement.gripper.joint_open
    mujoco.mj_kinematics(model, data)
    is_own = robot.world.subtree(placement.base_body)[model.geom_bodyid]
    geoms = np.flatnonzero(is_own & (model.geom_contype > 0))
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


class SizedBodies:
    """Bodies of one box or one upright cylinder each, whose sizes are written per copy.

    Writes everything that MuJoCo derives from a size: bounds of shape and body, and the inertia of a solid body. The
    size is then the task's alone: `object_size` of a `Randomisation` acts before it and is replaced.
    """

    def __init__(self, world: World, names: Sequence[str]) -> None:
        """Look the bodies up.

        Args:
            world: A world fresh from its model.
            names: Names of the bodies, which their geoms share.
        """
        model = world.model
        self._world = world
        geoms = np.array([model.geom(name).id for name in names], np.intp)
        bodies = np.array([model.body(name).id for name in names], np.intp)
        self._is_round = model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_CYLINDER
        boxes = model.body_bvhadr[bodies]  # of a body with one geom, its tree has one node
        self._size, self._radius, self._bounds = (
            ModelRows(world, field, geoms) for field in ("geom_size", "geom_rbound", "geom_aabb")
        )
        self._tree = ModelRows(world, "bvh_aabb", boxes)
        self._mass, self._inertia = (ModelRows(world, field, bodies) for field in ("body_mass", "body_inertia"))
        self._bodies = bodies

    def write(self, half: NDArray[np.float64], where: CopyIndex, density: float | None = None) -> None:
        """Write the sizes of some copies.

        Args:
            half: Half the extents of each body along its x, y, z [m], (*leading of these, bodies, 3). For a
                cylinder, x and y are its radius.
            where: The copies; `...` for all, or for the only one.
            density: Density that gives the masses [kg/m³]; None to keep the present masses.
        """
        copies = None if where is ... else where
        x, y, z = half[..., 0], half[..., 1], half[..., 2]
        size = half.copy()
        size[..., 1] = np.where(self._is_round, z, y)
        size[..., 2] = np.where(self._is_round, 0.0, z)
        bounds = np.concatenate([np.zeros_like(half), half], axis=-1)
        self._size.write(size, copies)
        self._radius.write(np.sqrt(x * x + np.where(self._is_round, 0.0, y * y) + z * z), copies)
        self._bounds.write(bounds, copies)
        self._tree.write(bounds, copies)
        if density is None:
            mass: NDArray[np.float64] = self._world.field("body_mass")[where][..., self._bodies]
        else:
            mass = density * np.where(self._is_round, 2.0 * np.pi, 8.0) * x * y * z
            self._mass.write(mass, copies)
        # Solid box: m (b² + c²) / 3 with half extents; solid cylinder: m (r² / 4 + h² / 3) across, m r² / 2 along.
        share = np.where(self._is_round, 0.25, 1.0 / 3.0)
        upright = share * y * y + z * z * (1.0 / 3.0), share * x * x + z * z * (1.0 / 3.0), share * (x * x + y * y)
        self._inertia.write(mass[..., None] * np.stack(upright, axis=-1), copies)
        self._world.update_constants(copies)
