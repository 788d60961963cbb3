"""Pick-Cuboid, the paper's task: grasp a cuboid that lies anywhere in the workspace, lift it and hold it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.draws import Draws
from rcs.envs.layers import Where
from rcs.envs.task import Area, Judgement, Task
from rcs.errors import InvalidSetup
from rcs.sim.robot import SimRobot
from rcs.sim.scene import Scene
from rcs.sim.world import World
from rcs.tasks.lifting import FreeBody, HoldCounter, LiftOptions, add_box, progress, upright

SIZE = (0.064, 0.032, 0.0576)
"""Edges of the 3D-printed cuboid along its x, y, z [m] (the paper's)."""
MASS = 0.05
"""Mass of such a cuboid printed in PLA with a usual infill [kg]."""
TOUCH_FORCE = 0.5
"""Least force of a pad that counts as contact with the cuboid [N] (ManiSkill's PickCube)."""
CUBOID = "cuboid"


class PickCuboid(Task):
    """Lift the cuboid, by 10 cm and for one second by default.

    The reward is 1 per step at success, below that the mean of three parts in [0, 1]: reaching, grasping, and lifting
    while grasping, in the form of ManiSkill 3's PickCube-v1 (`1 - tanh(5 d)`).
    """

    memory = ("_rest_height", "_held")
    instruction = "pick up the green cuboid"
    expert = "PickExpert"
    Options = LiftOptions
    options: LiftOptions

    def __init__(self, area: Area, options: LiftOptions | Mapping[str, Any] | None = None) -> None:
        """Set the area; the cuboid's centre is anywhere in it, at any yaw."""
        super().__init__(area, options)
        self.edges = tuple(area.object_scale * edge for edge in SIZE)
        """Edges of the cuboid here [m]."""

    def furnish(self, scene: Scene) -> None:
        """Add a table and the cuboid."""
        scene.add_table()
        mass = MASS * self.area.object_scale**3
        add_box(scene, CUBOID, self.area.center, edges=self.edges, mass=mass, rgb=(0.10, 0.55, 0.20))

    def objects(self) -> list[str]:
        """Return the cuboid."""
        return [CUBOID]

    def bind(self, world: World, robots: list[SimRobot]) -> None:
        """Register the cuboid's pose and the pads' forces on it for readout.

        Raises:
            InvalidSetup: There is not exactly one robot, or it has no gripper.
        """
        if len(robots) != 1 or robots[0].placement.gripper is None:
            raise InvalidSetup("PickCuboid needs one robot with a gripper.")
        robot = robots[0]
        placement, gripper = robot.placement, robots[0].gripper
        self._world = world
        self._robot = robot
        model = world.model
        cuboid = world.geom_flags([CUBOID])
        self._pose = world.core.read_body_pose(model.body(CUBOID).id, robot.layout.base_body)
        self._pads = [
            world.core.read_force(world.geom_flags(placement.gripper_prefix + name for name in pads), cuboid)
            for pads in gripper.pad_geoms
        ]
        self._touched = world.core.read_force(world.subtree_flags(placement.base_body), cuboid)
        self._body = FreeBody(world, CUBOID)
        self._held = HoldCounter(world, self.options.hold_time)
        self._geom = int(model.geom(CUBOID).id)
        self._rest_height = np.full(world.leading, self.edges[2] / 2)
        # The pose for agents is in the base frame, which may be anywhere; the height is in the scene.
        self._in_scene = world.core.read_body_pose(model.body(CUBOID).id, 0)

    def reset(self, draws: Draws, where: Where) -> None:
        """Put the cuboid at a random place and yaw."""
        self._rest_height = self._world.field("geom_size")[..., self._geom, 2].copy()  # varies between episodes
        self._body.place(upright(self.area.draw_place(draws), self._rest_height[where]), where)
        self._held.reset(where)

    def object_poses(self) -> dict[str, NDArray[np.float64]]:
        """Return the cuboid's pose in the scene."""
        return {CUBOID: self._world.poses[..., self._in_scene, :].copy()}

    def place(self, poses: Mapping[str, NDArray[np.float64]], where: Where) -> None:
        """Put the cuboid at a given pose."""
        if CUBOID in poses:
            self._body.place(poses[CUBOID], where)

    def evaluate(self) -> Judgement:
        """Judge height, grasp and duration."""
        touches = self._world.forces > TOUCH_FORCE
        poses = self._world.poses
        cuboid = poses[..., self._pose, :].copy()
        is_grasped = touches[..., self._pads[0]] & touches[..., self._pads[1]]
        height = poses[..., self._in_scene, 2] - self._rest_height
        goal = self.options.lift_height
        success = self._held.count((height > goal) & is_grasped)
        offset = cuboid[..., :3] - poses[..., self._robot.tcp_readout, :3]
        reward = self.reward(progress(np.sqrt(np.vecdot(offset, offset)), is_grasped, height, goal), success)
        info = {
            "success": success,
            "is_grasped": is_grasped,
            "is_touched": touches[..., self._touched],
            "cuboid": cuboid,
        }
        return Judgement(reward=reward, terminated=success, info=info)

    def describe(self) -> dict[str, NDArray[Any]]:
        """Return the cuboid's pose."""
        never = np.zeros(self._world.leading, np.bool_)
        cuboid = self._world.poses[..., self._pose, :].copy()
        return {"success": never, "is_grasped": never, "is_touched": never, "cuboid": cuboid}
