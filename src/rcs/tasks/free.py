"""No task: a robot and a table, for trying things out."""

from __future__ import annotations

from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.layers import CopyIndex
from rcs.envs.task import Judgement, Task
from rcs.sim.robot import SimRobot
from rcs.sim.world import World


class Free(Task):
    """A task without objects, reward or end."""

    def bind(self, world: World, robots: list[SimRobot]) -> None:
        """Look up nothing."""

    def reset(self, random: EpisodeRandom, where: CopyIndex) -> None:
        """Do nothing: the robot starts at home."""

    def evaluate(self) -> Judgement:
        """Judge nothing: the reward is 0, and no step terminates the episode."""
        return Judgement()
