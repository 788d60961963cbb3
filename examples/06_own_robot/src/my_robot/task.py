"""A task and its expert: push a block over a line, away from the robot."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.agents import Phase, Plan, Script, ScriptedArm
from rcs.envs import CopyIndex, EpisodeRandom, Judgement
from rcs.sim import Scene
from rcs.tasks import TableTask, add_box, upright

BLOCK = "block"
EDGE = 0.05
"""Edge of the block [m]."""
LINE = 0.10
"""Distance of the line from the middle of the lab's area [m]."""


class PushToLine(TableTask):
    """Push the block over the white line.

    The reward is based on progress, `1 - tanh(5 d)` of the remaining distance `d`.
    """

    names = (BLOCK,)
    instruction = "push the block over the line"
    expert = "LineExpert"

    def furnish(self, scene: Scene) -> None:
        """Add a table, the block and the line."""
        scene.add_table()
        add_box(scene, BLOCK, self.area.center, edges=(EDGE,) * 3, mass=0.1, rgb=(0.2, 0.3, 0.8))
        scene.spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[self.area.center[0] + LINE, self.area.center[1], 0.0],
            size=[0.005, 0.20, 0.001],
            rgba=[1.0, 1.0, 1.0, 1.0],
            contype=0,  # it is painted on: nothing touches it
            conaffinity=0,
            group=0,
        )

    def reset(self, random: EpisodeRandom, where: CopyIndex) -> None:
        """Lay the block down before the line. Arrays have a row per copy that starts, or no such axis for one alone."""
        x, y = self.area.center
        place = random.uniform([x - 0.05, y - 0.10, -0.2], [x + 0.03, y + 0.10, 0.2])
        self.bodies[BLOCK].place(upright(place, np.full(place.shape[:-1], EDGE / 2)), where)

    def evaluate(self) -> Judgement:
        """Judge the remaining distance of the block."""
        block = self.poses_of(BLOCK).copy()
        left = np.maximum(self.area.center[0] + LINE - block[..., 0], 0.0)
        return Judgement(success=left == 0.0, progress=1.0 - np.tanh(5.0 * left), info={BLOCK: block})

    def describe(self) -> dict[str, NDArray[Any]]:
        """Return the initial pose of the block."""
        return {"success": np.zeros(self._world.leading, np.bool_), **self.object_poses()}


class LineExpert(Script):
    """Moves down behind the block with closed fingers, and pushes."""

    task = "PushToLine"
    needs = (BLOCK,)
    phases = (
        Phase("approach", "above", speed=0.3, opening=0.0),
        Phase("descend", "behind", opening=0.0),
        Phase("push", "beyond", speed=0.10, opening=0.0),
    )

    def plan(self, arm: ScriptedArm) -> Plan:
        """Plan a straight push along the base's x axis, with the initial orientation of the tool."""
        x, y = self.info[BLOCK][:2]

        def tool_at(x: float, height: float) -> NDArray[np.float64]:
            return np.concatenate(([x, y, height], arm.target[3:]))

        return {"above": tool_at(x - 0.08, 0.12), "behind": tool_at(x - 0.08, 0.02), "beyond": tool_at(x + 0.15, 0.02)}
