"""A simulated world with its robots and a task: how episodes begin and how they are judged."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.draws import Draws
from rcs.envs.layers import Where
from rcs.envs.task import Outcome, Task
from rcs.sim.robot import SimRobot
from rcs.sim.world import Copies, World


class Scenario:
    """World, robots and task, for one copy and for many."""

    def __init__(self, world: World, robots: list[SimRobot], task: Task) -> None:
        """Put all robots at home and take that as the state that every episode begins with.

        Args:
            world: A world fresh from its model.
            robots: Its robots.
            task: What to do in it.
        """
        self.world = world
        self.robots = robots
        self.task = task
        task.bind(world, robots)
        for robot in robots:
            robot.go_home()
        world.core.keep_initial_state()
        world.refresh()

    def begin(self, draws: Draws, copies: Copies = None) -> None:
        """Start episodes: all robots at home, the task's objects where it puts them.

        Args:
            draws: Random numbers for these copies.
            copies: Which copies; None for all.
        """
        where: Where = ... if copies is None else copies
        self.world.reset(copies)
        self.task.reset(draws, where)
        self.world.refresh(copies)

    def evaluate(self) -> Outcome:
        """Judge the present state."""
        return self.task.evaluate()

    def describe(self) -> dict[str, NDArray[Any]]:
        """Return the info of the first observation of an episode."""
        return self.task.describe()

    def __str__(self) -> str:
        """Return the task's name and the number of copies."""
        copies = f", {self.world.copies} copies" if self.world.leading else ""
        physics = np.round(1 / self.world.model.opt.timestep)
        control = f"{self.world.mode} {self.world.frequency:g} Hz"
        return f"{type(self.task).__name__} in MuJoCo at {physics:g} Hz, {control}{copies}"
