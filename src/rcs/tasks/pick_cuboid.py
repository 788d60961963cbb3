"""PickCuboid, the paper's task: grasp a cuboid that lies anywhere in the workspace, lift it and hold it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from rcs_data.options import Meta

from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.layers import CopyIndex
from rcs.envs.task import Area, Circle, Judgement
from rcs.errors import InvalidSetup
from rcs.sim.robot import SimRobot
from rcs.sim.scene import Scene
from rcs.sim.world import World
from rcs.spatial import compose
from rcs.tasks.clutter import MOST_DISTRACTORS, MOST_OBSTACLES, Distractors, Obstacles, SizedBodies
from rcs.tasks.holding import SLIP, TOUCH_FORCE, Grip, HoldTimer
from rcs.tasks.lifting import LiftOptions, add_box, any_of, lowest, progress, table_height, upright
from rcs.tasks.table_task import TableTask

SIZE = (0.064, 0.032, 0.0576)
"""Edges of the 3D-printed cuboid along its x, y, z [m] (the paper's)."""
MASS = 0.05
"""Mass of such a cuboid printed in PLA with a usual infill [kg]."""
CUBOID = "cuboid"
EDGE_FACTORS = (0.7, 1.1)
"""Factors on each edge of a cuboid of random size: its shorter side still fits into every gripper, however it lies."""
FREE, NEAR = 0.09, 0.22
"""Radius around the cuboid that distractors leave to an open gripper, and half the edge of the square in which they lie
[m], at the usual size of objects."""
POSES = {
    "usual": (0.0, 0.0, 0.0, 1.0),
    "flat": (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)),
    "standing": (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)),
}
"""Quaternions xyzw of the cuboid on its lower face, on its largest one (y points up) and on its smallest (x)."""


class PickOptions(LiftOptions):
    """Options of PickCuboid; each from `distractors` to `obstacles` makes it harder, and they combine."""

    distractors: Annotated[int, Meta(ge=0, le=MOST_DISTRACTORS)] = 0
    """How many boxes and cylinders of random sizes and colours, none of them green, lie around the cuboid, 0 to 16."""
    pose: Literal["usual", "flat", "standing", "any"] = "usual"
    """How the cuboid lies: on its lower face, on its largest one, on its smallest one, or on any of these by chance."""
    edges: Literal["fixed", "random"] = "fixed"
    """Whether each edge is the usual one, or drawn from 0.7 to 1.1 times that; `object_size` of a randomisation then
    does nothing to the cuboid."""
    area: Literal["lab", "large"] = "lab"
    """Where the cuboid lies: in the lab's area, or in the larger one that the robot reaches."""
    obstacles: Annotated[int, Meta(ge=0, le=MOST_OBSTACLES)] = 0
    """How many posts stand around the cuboid, 0 to 8: firm, higher than the flange when it grasps, and clear of the
    robot at home. The scripted expert does not see them; the agent `planner` goes around them."""
    placed_by: Literal["reset", "robot"] = "reset"
    """Placement of the cuboid for an episode of a collection: by the reset, which beside a real robot is a person, or
    by the robot, which sets it down after each success. Needs a cuboid of the usual size and pose, and no others."""

    def __post_init__(self) -> None:
        """Check the options.

        Raises:
            InvalidSetup: A value is invalid, or the robot cannot place the cuboid of these options.
        """
        super().__post_init__()
        needed = {"distractors": 0, "pose": "usual", "edges": "fixed", "obstacles": 0}
        wrong = [name for name, value in needed.items() if getattr(self, name) != value]
        if self.placed_by == "robot" and wrong:
            raise InvalidSetup(
                f"placed_by is 'robot' and {wrong[0]} is {getattr(self, wrong[0])!r}; the robot sets down cuboids with "
                f"{', '.join(f'{name}={value!r}' for name, value in needed.items())}. Use these, or placed_by='reset'."
            )


class PickCuboid(TableTask):
    """Lift the cuboid, by 10 cm and for one second by default.

    It is a success when, without a break for that time, all of the cuboid is that high, both pads of the gripper press
    on it with more than its weight, nothing but the gripper touches it, and it moves by no more than 1 cm in the hand.
    This is judged at the end of each step.

    Progress, of which the reward is made, is the mean of three parts in [0, 1]: reaching, grasping, and lifting while
    grasping, which are those of ManiSkill 3's PickCube-v1. Reaching distinguishes the last centimetres, and each
    centimetre of lifting counts alike.
    """

    memory = ("_half_edges", "_table", "_held", "_grip")
    names = (CUBOID,)
    instruction = "pick up the green cuboid"
    expert = "PickExpert"
    placer = "rcs.agents.experts:SetDownExpert"
    Options = PickOptions
    options: PickOptions

    def __init__(self, area: Area, options: PickOptions | Mapping[str, Any] | None = None) -> None:
        """Set the area; the cuboid's centre is anywhere in it, at any yaw."""
        super().__init__(area, options)
        if self.options.area == "large":
            self.area = area.enlarged()
        self.edges = tuple(area.object_scale * edge for edge in SIZE)
        """Edges of the cuboid here [m], unless they are random."""
        self._distractors = Distractors(self.options.distractors, scale=area.object_scale)
        self._obstacles = Obstacles(self.options.obstacles, scale=area.object_scale)
        self._occupied: list[Circle] = []

    def furnish(self, scene: Scene) -> None:
        """Add a table and the cuboid."""
        scene.add_table()
        mass = MASS * self.area.object_scale**3
        add_box(scene, CUBOID, self.area.center, edges=self.edges, mass=mass, rgb=(0.10, 0.55, 0.20))
        self._distractors.furnish(scene)
        self._obstacles.furnish(scene)

    def bind(self, world: World, robots: list[SimRobot]) -> None:
        """Register the cuboid's pose and the pads' forces on it for readout.

        Raises:
            InvalidSetup: There is not exactly one robot, or it has no gripper.
        """
        super().bind(world, robots)
        self._robot = robot = robots[0]
        model = world.model
        self._pose = world.core.read_body_pose(model.body(CUBOID).id, robot.layout.base_body)
        self._grip = Grip(world, robots, CUBOID)
        self._touched = world.core.read_force(
            world.subtree_flags(robot.placement.base_body), world.geom_flags([CUBOID])
        )
        self._held = HoldTimer(world, self.options.hold_time, SLIP, places=1)
        self._geom = int(model.geom(CUBOID).id)
        self._half_edges = np.zeros((*world.leading, 3))
        self._sizes = SizedBodies(world, [CUBOID]) if self.options.edges == "random" else None
        self._distractors.bind(world)
        self._obstacles.bind(world, robot)
        self._table = table_height(world)

    def reset(self, random: EpisodeRandom, where: CopyIndex) -> None:
        """Put the cuboid at a random place and yaw."""
        if self._sizes is not None:
            factor = random.branch("edges").uniform([EDGE_FACTORS[0]] * 3, [EDGE_FACTORS[1]] * 3)
            self._sizes.write(0.5 * factor[..., None, :] * self.edges, where)
        self._half_edges = self._world.field("geom_size")[..., self._geom, :].copy()  # varies between episodes
        self._table = table_height(self._world).copy()
        pose = upright(self.area.draw_place(random), self._table[where])
        middle = pose[..., :2].copy()
        pose = compose(pose, self._lying(random))
        pose[..., 2] += self._table[where] - lowest(pose, self._half_edges[where])
        self.bodies[CUBOID].place(pose, where)
        scale = self.area.object_scale
        posts = self._obstacles.reset(random, where, middle)
        around = (middle, np.full(middle.shape[:-1], scale * NEAR))
        occupied = [(middle, scale * FREE), *posts]
        self._occupied = posts + self._distractors.reset(random, where, self.area, occupied, around=around)
        self._held.reset(where)
        self._grip.reset()

    def occupied(self) -> list[Circle]:
        """Return the circles of posts and distractors."""
        return self._occupied

    def _lying(self, random: EpisodeRandom) -> NDArray[np.float64]:
        """Return the cuboid's orientations as poses (*leading, 7) without a translation."""
        pose = np.zeros((*random.leading, 7))
        if self.options.pose == "any":
            choice = np.floor(random.branch("pose").uniform(0.0, len(POSES))).astype(np.intp)
            pose[..., 3:] = np.array(list(POSES.values()))[choice]
        else:
            pose[..., 3:] = POSES[self.options.pose]
        return pose

    def evaluate(self) -> Judgement:
        """Judge height, grasp and duration."""
        seen = self.seen()
        is_grasped = self._grip.grasps()[..., 0]
        goal = self.options.lift_height
        height = np.zeros(())
        is_held = is_grasped
        if any_of(is_grasped):
            height = lowest(self.poses_of(CUBOID), self._half_edges) - self._table
            is_held = is_grasped & (height >= goal) & self._grip.is_free()
        success = self._held.count(is_held, self._grip.places())
        offset = seen["cuboid"][..., :3] - self._world.poses[..., self._robot.tcp_readout, :3]
        is_touched = self._world.forces[..., self._touched] > TOUCH_FORCE
        info = {"is_grasped": is_grasped, "is_touched": is_touched, **seen}
        come = progress(np.sqrt(np.vecdot(offset, offset)), is_grasped, height / goal)
        return Judgement(success=success, progress=come, is_placed=is_held, info=info)

    def seen(self) -> dict[str, NDArray[Any]]:
        """Return the cuboid's pose in the robot's base frame, and its edges [m]."""
        return {"cuboid": self._world.poses[..., self._pose, :].copy(), "edges": 2.0 * self._half_edges}
