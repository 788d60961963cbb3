"""Lift-Bar: two arms grasp a bar at its ends, lift it together and hold it level."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.layers import CopyIndex
from rcs.envs.task import Judgement
from rcs.sim.robot import SimRobot
from rcs.sim.scene import Scene
from rcs.sim.world import World
from rcs.tasks.holding import SLIP, Grip, HoldTimer
from rcs.tasks.lifting import LiftOptions, add_box, lowest, norm, progress, table_height, upright
from rcs.tasks.table_task import TableTask

EDGES = (0.035, 0.50, 0.05)
"""Edges of the bar along its x, y, z [m]: too long and too heavy at one end for one hand."""
MASS = 0.30
"""Mass of such a bar of light wood [kg]."""
GRASP_AT = 0.8
"""Grasped points along its y, between its middle (0) and its ends (1)."""
MAX_TILT = np.deg2rad(10.0)
"""Tilt above which the bar does not count as level [rad]."""
MAX_YAW = 0.35
"""Largest turn of the bar at the start [rad]; beyond, the arms would cross."""
BAR = "bar"


class LiftBar(TableTask):
    """Grasp a bar at both ends with two arms, lift it, by 10 cm by default, and hold it level, for one second.

    It is a success when, without a break for that time, both ends of the bar are that high and it leans by less than
    10 degrees, all four pads press on it with more than its weight, nothing but the grippers touches it, and it moves
    by no more than 1 cm in each hand. This is judged at the end of each step.

    Progress, of which the reward is made, is the mean over the arms of reaching, grasping, and lifting while grasping.
    """

    memory = ("_half_edges", "_table", "_grasp_offset", "_ends", "_held", "_grip")
    names = (BAR,)
    robots_needed = 2
    flags = ("is_grasped",)
    instruction = "lift the bar with both arms"
    expert = "LiftExpert"
    Options = LiftOptions
    options: LiftOptions

    def furnish(self, scene: Scene) -> None:
        """Add a table and the bar."""
        scene.add_table()
        add_box(scene, BAR, self.area.center, edges=EDGES, mass=MASS, rgb=(0.12, 0.30, 0.62))

    def bind(self, world: World, robots: list[SimRobot]) -> None:
        """Register the bar's pose and the pads' forces on it for readout.

        Raises:
            InvalidSetup: There are not exactly two robots, or one has no gripper.
        """
        super().bind(world, robots)
        self._tcps = [world.core.read_pose(robot.layout.tcp_site, 0) for robot in robots]
        self._grip = Grip(world, robots, BAR)
        self._held = HoldTimer(world, self.options.hold_time, SLIP, places=len(robots))
        self._geom = int(world.model.geom(BAR).id)
        self._measure()

    def _measure(self) -> None:
        """Take over the bars' sizes and the tables' heights, which may vary between episodes."""
        self._half_edges = self._world.field("geom_size")[..., self._geom, :].copy()
        self._table = table_height(self._world).copy()
        self._grasp_offset = GRASP_AT * self._half_edges[..., 1]
        # The first robot stands on the left and takes the end at larger y.
        self._ends = np.stack([self._grasp_offset, -self._grasp_offset], axis=-1)

    def reset(self, random: EpisodeRandom, where: CopyIndex) -> None:
        """Put the bar at a random place, turned slightly."""
        self._measure()
        height = (self._table + self._half_edges[..., 2])[where]
        self.bodies[BAR].place(upright(self.area.draw_place(random, MAX_YAW), height), where)
        self._held.reset(where)
        self._grip.reset()

    def evaluate(self) -> Judgement:
        """Judge height, level and grasps, and for how long."""
        seen = self.seen()
        bar, grasped = seen["bar_in_scene"], self._grip.grasps()
        both = grasped[..., 0] & grasped[..., 1]
        x, y = bar[..., 3], bar[..., 4]
        is_level = 1.0 - 2.0 * (x * x + y * y) > np.cos(MAX_TILT)  # z component of the bar's z axis
        height = lowest(bar, self._half_edges) - self._table
        goal = self.options.lift_height
        is_held = (height >= goal) & is_level & both & self._grip.is_free()
        success = self._held.count(is_held, self._grip.places())
        distances = norm(self._world.poses[..., self._tcps, :3] - self._grasps(bar))
        come = progress(distances, grasped, (height / goal)[..., None]).mean(axis=-1)
        return Judgement(success=success, progress=come, is_placed=is_held, info={"is_grasped": both, **seen})

    def _grasps(self, bar: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the grasp points of both ends in the scene, (..., 2, 3)."""
        x, y, z, w = (bar[..., 3 + i] for i in range(4))
        axis = np.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)], axis=-1)
        return bar[..., None, :3] + self._ends[..., None] * axis[..., None, :]

    def seen(self) -> dict[str, NDArray[Any]]:
        """Return the bar's pose, and the distance of the grasp points from its middle along its y [m]."""
        return {"bar_in_scene": self.poses_of(BAR).copy(), "grasp_offset": self._grasp_offset.copy()}
