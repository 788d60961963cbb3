"""Push: push a block along the table onto a marked goal, with a closed gripper."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from rcs_data.options import Positive

from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.layers import CopyIndex
from rcs.envs.task import Area, Judgement, Task
from rcs.errors import InvalidSetup
from rcs.sim.robot import SimRobot
from rcs.sim.scene import Scene
from rcs.sim.world import World
from rcs.tasks.holding import Grip, HoldTimer
from rcs.tasks.lifting import add_box, lowest, nearness, norm, table_height, upright
from rcs.tasks.table_task import TableTask

EDGES = (0.06, 0.06, 0.05)
"""Edges of the block along its x, y, z [m]. Lower than wide, so that it slides before it tips."""
MASS = 0.10
"""Mass of such a block of light wood [kg]."""
FRICTION = 0.4
"""Sliding friction of dry wood on smooth surfaces, 0.3 to 0.5. With more, a block jams between tool and table."""
MARGIN = 0.08
"""Least distance of the block's middle and of the goal from the edge of the area [m]: room for a gripper behind it."""
SHORTEST_WAY = 0.10
"""Least distance from the block to the goal at the start [m]."""
TRIES = 16
"""Goals that are drawn; the first that is far enough away counts."""
LIFTED = 0.005
"""Height of the block's lowest corner above the table at which it counts as lifted [m]."""
GRASP_OPENING = 0.1
"""Opening above which a gripper grasps what both pads press on; those of a closed one may both push, side by side."""
STILL = (0.01, 0.1)
"""Speed below which the block is at rest [m/s, rad/s] (ManiSkill 3's `Actor.is_static`)."""
TOUCH_FORCE = 0.05
"""Least force of the robot that counts as contact with the block [N]; the block slides at 0.4 N."""
MAX_TILT = np.deg2rad(5.0)
"""Largest angle between the table and the face on which a block lies [rad]."""
BLOCK = "block"
GOAL = "goal"


class PushOptions(Task.Options):
    """Options of pushing."""

    tolerance: Positive = 0.03
    """Largest distance of the block's middle from that of the goal, which is also the goal's radius [m]."""
    hold_time: Positive = 0.5
    """How long the block must lie there at rest [s]."""


class Push(TableTask):
    """Push the block until its middle is over the red disc, and let it lie there at rest, by default for half a second.

    It must lie flat on the table and stay there: an episode in which it was lifted or grasped is lost. This is judged
    at the end of each step.

    Progress, of which the reward is made, is one third for the distance from the TCP to where the block is pushed, and
    two thirds for the block's from the goal, in the form of ManiSkill 3's PushCube-v1 (`1 - tanh(5 d)`), to which the
    latter adds a finer one, for the goal is small. Once the block was lifted, it is 0.
    """

    memory = ("_lies_there", "_was_lifted", "_half_edges", "_table", "_grip")
    names, marks = (BLOCK,), (GOAL,)
    takes_hands = True
    flags = ("is_touched",)
    instruction = "push the blue block onto the red disc"
    expert = "PushExpert"
    Options = PushOptions
    options: PushOptions

    def __init__(self, area: Area, options: PushOptions | Mapping[str, Any] | None = None) -> None:
        """Set the area, in which block and goal lie, at any yaw and with room behind the block."""
        super().__init__(area, options)
        scale = area.object_scale
        self.edges = tuple(scale * edge for edge in EDGES)
        """Edges of the block here [m]."""
        half = np.maximum(np.array(area.size) / 2 - scale * MARGIN, 0.0)
        self._low, self._high = np.array(area.center) - half, np.array(area.center) + half

    def furnish(self, scene: Scene) -> None:
        """Add a table, the block, and a disc that marks the goal."""
        scene.add_table()
        mass = MASS * self.area.object_scale**3
        add_box(scene, BLOCK, self.area.center, edges=self.edges, mass=mass, rgb=(0.10, 0.30, 0.65))
        # Wood slides on a table top and on a gripper, whatever friction those have by themselves.
        block = scene.spec.geom(BLOCK)
        block.friction, block.priority = [FRICTION, 0.005, 0.0001], 2
        # The pose of a body with `mocap` is part of the state.
        scene.spec.worldbody.add_body(name=GOAL, mocap=True).add_geom(
            name=GOAL,
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[self.options.tolerance, 0.0005, 0.0],
            pos=[0.0, 0.0, 0.0005],
            rgba=[0.80, 0.12, 0.10, 1.0],
            contype=0,
            conaffinity=0,
            group=0,
        )

    def bind(self, world: World, robots: list[SimRobot]) -> None:
        """Register the poses of block and goal, and forces on the block, for readout.

        Raises:
            InvalidSetup: There is not exactly one robot, it has neither gripper nor hand, or the task could begin done,
                because no goal in the area is farther from a block in its middle than the tolerance.
        """
        super().bind(world, robots)
        if np.linalg.norm(self._high - self._low) / 2 <= self.options.tolerance:
            raise InvalidSetup(
                f"The area is {self.area.size} m, too small for Push with a tolerance of {self.options.tolerance:g} m: "
                f"block and goal lie {self.area.object_scale * MARGIN:g} m or more from its edge. Choose another robot "
                "or a smaller tolerance, or set a larger `size` of the lab's Area."
            )
        self._robot = robot = robots[0]
        model, core, placement = world.model, world.core, robots[0].placement
        block, goal = int(model.body(BLOCK).id), int(model.body(GOAL).id)
        base = robot.layout.base_body
        self._block, self._goal = core.read_body_pose(block, base), core.read_body_pose(goal, base)
        self._tcp = core.read_pose(robot.layout.tcp_site, 0)
        self._touched = core.read_force(world.subtree_flags(placement.base_body), world.geom_flags([BLOCK]))
        self._grip = None if placement.gripper is None else Grip(world, robots, BLOCK)
        first = int(model.joint(BLOCK).dofadr[0])
        self._velocity = slice(first, first + 6)
        self._geom = int(model.geom(BLOCK).id)
        self._lies_there = HoldTimer(world, self.options.hold_time)
        self._was_lifted = np.zeros(world.leading, np.bool_)
        self._half_edges = np.zeros((*world.leading, 3))
        self._table = table_height(world)

    def reset(self, random: EpisodeRandom, where: CopyIndex) -> None:
        """Put the block at a random place and yaw, and the goal somewhere else."""
        place = random.uniform(np.append(self._low, -np.pi), np.append(self._high, np.pi))
        goals = random.uniform(np.tile(self._low, (TRIES, 1)), np.tile(self._high, (TRIES, 1)))
        # If all of them are too near: the corner that is farthest away.
        middle = (self._low + self._high) / 2
        goals[..., -1, :] = np.where(place[..., :2] < middle, self._high, self._low)
        dx, dy = (goals[..., axis] - place[..., axis, None] for axis in range(2))
        is_far = dx * dx + dy * dy >= max(self.area.object_scale * SHORTEST_WAY, self.options.tolerance) ** 2
        is_far[..., -1] = True
        goal = np.take_along_axis(goals, is_far.argmax(axis=-1)[..., None, None], axis=-2)[..., 0, :]
        self._half_edges = self._world.field("geom_size")[..., self._geom, :].copy()  # varies between episodes
        self._table = table_height(self._world).copy()
        self.bodies[BLOCK].place(upright(place, (self._table + self._half_edges[..., 2])[where]), where)
        level = np.concatenate([goal, np.zeros_like(goal[..., :1])], axis=-1)
        self.bodies[GOAL].place(upright(level, self._table[where]), where)
        was_lifted = np.array(self._was_lifted)  # of one copy it is a number of NumPy's
        was_lifted[where] = False
        self._was_lifted = was_lifted
        self._lies_there.reset(where)
        if self._grip is not None:
            self._grip.reset()

    def evaluate(self) -> Judgement:
        """Judge where the block is, whether it lies still, and whether it stayed on the table."""
        poses = self._world.poses
        block, goal = self.poses_of(BLOCK), self.poses_of(GOAL)
        height = lowest(block, self._half_edges) - self._table
        self._was_lifted = self._was_lifted | (height > LIFTED) | self._is_grasped()
        way = goal[..., :3] - block[..., :3]
        way[..., 2] = 0.0
        distance = norm(way)
        is_there = distance <= self.options.tolerance
        velocity = self._world.qvel[..., self._velocity]
        is_still = (norm(velocity[..., :3]) < STILL[0]) & (norm(velocity[..., 3:]) < STILL[1])
        is_placed = is_there & _is_flat(block) & ~self._was_lifted
        success = self._lies_there.count(is_placed & is_still)
        # Where to push is behind the block, on the side that is away from the goal.
        behind = block[..., :3] - way * (self._half_edges[..., 0] / np.maximum(distance, 1e-9))[..., None]
        reach = np.where(is_there, 1.0, 1.0 - np.tanh(5.0 * norm(poses[..., self._tcp, :3] - behind)))
        progress = (1.0 / 3.0) * (reach + 2.0 * nearness(distance))
        progress = np.where(self._was_lifted, 0.0, progress)
        is_touched = self._world.forces[..., self._touched] > TOUCH_FORCE
        info = {"is_touched": is_touched, **self.seen()}
        return Judgement(success=success, progress=progress, is_placed=is_placed, info=info)

    def seen(self) -> dict[str, NDArray[Any]]:
        """Return the poses of block and goal, the edges of the block, and whether it was lifted."""
        poses = self._world.poses
        return {
            "was_lifted": np.array(self._was_lifted),
            "block": poses[..., self._block, :].copy(),
            "goal": poses[..., self._goal, :].copy(),
            "edges": 2.0 * self._half_edges,
        }

    def _is_grasped(self) -> NDArray[np.bool_]:
        """Return which blocks are between the pads of an open gripper, (*leading,)."""
        if self._grip is None:
            return np.zeros(self._world.leading, np.bool_)
        return self._grip.grasps()[..., 0] & (self._robot.opening[..., 0] > GRASP_OPENING)


def _is_flat(pose: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether a face of a box points straight up, (*leading,)."""
    x, y, z, w = (pose[..., 3 + i] for i in range(4))
    up = np.abs(np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]))
    return up.max(axis=0) > np.cos(MAX_TILT)
