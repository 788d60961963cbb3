"""No task: a robot and a table, for trying things out."""

from __future__ import annotations

import numpy as np

from rcs.envs.draws import Draws
from rcs.envs.layers import Where
from rcs.envs.task import Judgement, Task
from rcs.sim.robot import SimRobot
from rcs.sim.world import World


class Free(Task):
    """A task without objects, reward or end."""

    def bind(self, world: World, robots: list[SimRobot]) -> None:
        """Remember the leading shape."""
        self._leading = world.leading

    def reset(self, draws: Draws, where: Where) -> None:
        """Do nothing: the robot starts at home."""

    def evaluate(self) -> Judgement:
        """Return reward 0, never terminated, and no `success`."""
        return Judgement(reward=np.zeros(self._leading), terminated=np.zeros(self._leading, np.bool_))
