"""A simulated world with its robots and a task: how episodes begin and how they are judged."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.layers import CopyIndex
from rcs.envs.reward import RewardKind, Rewards
from rcs.envs.spaces import GRIPPER, HAND, JOINTS
from rcs.envs.start import Start, in_frame_of
from rcs.envs.task import Judgement, Task
from rcs.envs.variation.clutter import Clutter, ObjectCircles
from rcs.envs.variation.randomiser import Randomiser
from rcs.errors import InvalidSetup
from rcs.sim.camera_feed import FrameClock
from rcs.sim.loads import CollisionGuard
from rcs.sim.robot import SimRobot
from rcs.sim.world import Copies, World


class Simulation:
    """World, robots and task, for one copy and for many."""

    def __init__(
        self,
        world: World,
        robots: list[SimRobot],
        task: Task,
        randomiser: Randomiser | None = None,
        frame_clock: FrameClock | None = None,
        clutter: Clutter | None = None,
        *,
        reward: RewardKind = "shaped",
        discount: float = 0.99,
    ) -> None:
        """Put all robots at home, the state in which every episode begins.

        Args:
            world: A world fresh from its model.
            robots: Its robots.
            task: The task.
            randomiser: Varies the world from episode to episode; None for a constant world.
            frame_clock: The cameras' clock, which needs the episode's random numbers; None without cameras.
            clutter: Other objects in the scene; None for none.
            reward: Rule of the reward.
            discount: Worth of a reward one step later to the learner.
        """
        self.world = world
        self.randomisers = [] if randomiser is None else [randomiser]
        """The randomisers of the world, in their order; more are added before the first episode."""
        self.frame_clock = frame_clock
        """The cameras' clock; None without cameras."""
        self.robots = robots
        self.guards: dict[str, CollisionGuard] = {}
        """The reactions to collisions, by robot."""
        self.task = task
        self.rewards = Rewards(world, robots, reward, discount)
        """Pays for each step."""
        self.judged: Mapping[str, Any] = {}
        """The task's info on the state that was judged last."""
        task.bind(world, robots)
        self._clutter = clutter
        if clutter is not None:
            clutter.bind(world)
            self._circles = ObjectCircles(world, task)
        for robot in robots:
            robot.go_home()
        for one in self.randomisers:
            one.settle()
        world.core.keep_initial_state()
        world.refresh()

    def begin(self, random: EpisodeRandom, copies: Copies = None) -> None:
        """Start episodes: all robots at or near home, objects placed by the task, all else randomised.

        Args:
            random: Random numbers for these copies.
            copies: Which copies; None for all.
        """
        where: CopyIndex = ... if copies is None else copies
        for randomiser in self.randomisers:
            randomiser.begin(random, copies)
        if self.frame_clock is not None:
            self.frame_clock.begin(random.branch("frames").bits(), copies)
        self.world.reset(copies)
        for randomiser in self.randomisers:
            randomiser.place(self.robots, copies)
        self.task.reset(random, where)
        self.world.refresh(copies)
        if self._clutter is not None:
            occupied = [*self._circles.at(where), *self.task.occupied()]
            self._clutter.reset(random.branch("randomisation"), where, self.task.area, occupied)
            self.world.refresh(copies)

    def start_at(self, start: Start) -> None:
        """Put robots and objects at a given start, right after `begin`; for a world of one copy.

        Args:
            start: The start.
        """
        for robot in self.robots:
            state = start.robots.get(robot.placement.name)
            if state is not None:
                robot.put(state[JOINTS], state.get(GRIPPER), state.get(HAND))
        for randomiser in self.randomisers:
            randomiser.settle()
        if start.objects:
            self.task.place(start.objects, ...)
        self.world.refresh()

    def object_poses(self) -> dict[str, NDArray[np.float64]]:
        """Return the poses of the task's objects by name, (*leading, 7) [m], xyzw.

        Poses are in the base frame of the robot; with several robots, in the scene. Recordings have those of the start
        in `outcome["objects"]`.
        """
        return in_frame_of(self.robots, self.task.object_poses())

    def faults(self, is_faulty: NDArray[np.bool_]) -> dict[str, Any]:
        """Return why the last step ended early, by robot, or as `simulation` where a world of one diverged.

        Args:
            is_faulty: In which copies a robot went into its fault state, (*leading,).

        Returns:
            A text per robot; of a batch, a text per copy, empty where a robot is well.
        """
        if not self.world.leading:
            if not is_faulty:
                why = self.world.why_diverged() or "a step failed"
                return {"simulation": f"{why}; the observation is the last good one"}
            return {name: reason for name, guard in self.guards.items() if (reason := guard.reason(0))}
        reasons: dict[str, Any] = {}
        for name, guard in self.guards.items():
            own = [guard.reason(copy) if faulty else "" for copy, faulty in enumerate(is_faulty)]
            if any(own):
                reasons[name] = np.array(own, object)
        return reasons

    def evaluate(self) -> Judgement:
        """Judge the present state.

        Raises:
            InvalidSetup: The task gives something else.
        """
        judgement = self.task.evaluate()
        if not isinstance(judgement, Judgement):
            raise InvalidSetup(f"{type(self.task).__name__}.evaluate returned {judgement!r}; valid is a Judgement.")
        self.judged = judgement.info
        return judgement

    def require_reward(self, reward: NDArray[np.float64], judgement: Judgement) -> None:
        """Check what a judgement pays.

        Raises:
            InvalidSetup: It is not a finite number for each copy.
        """
        if reward.shape != self.world.leading:
            wrong = f"a reward of the shape {reward.shape}; valid is {self.world.leading}, a number for each copy"
        elif not (np.isfinite(reward).all() if self.world.leading else math.isfinite(reward)):
            wrong = "a reward that is not finite"
        else:
            return
        parts = ", ".join(
            f"{name} {value}" for name in ("progress", "reward") if (value := getattr(judgement, name)) is not None
        )
        raise InvalidSetup(f"{type(self.task).__name__}.evaluate leads to {wrong}. It returned {parts}.")

    def judge_start(self, copies: Copies) -> dict[str, Any]:
        """Have the rewards of some copies' episodes count from the present state, and return the info of all copies.

        Copies that do not start keep the values of their last step.
        """
        judgement, info = self.evaluate(), self.describe()
        self.rewards.begin(judgement, ... if copies is None else copies)
        if copies is not None:
            others = np.ones(self.world.leading, np.bool_)
            others[copies] = False
            for key in info.keys() & judgement.info.keys():
                info[key] = np.array(info[key])  # keys may share an array
                info[key][others] = judgement.info[key][others]
        return info

    @property
    def randomisation(self) -> dict[str, NDArray[np.float64]]:
        """The draws of the present episodes, by field of `Randomisation`, (*leading, ...)."""
        return {field: drawn for randomiser in self.randomisers for field, drawn in randomiser.values.items()}

    def describe(self) -> dict[str, Any]:
        """Return the info of the first observation of an episode."""
        info: dict[str, Any] = dict(self.task.describe())
        if self.randomisers:
            info["randomisation"] = self.randomisation
        return info

    def __str__(self) -> str:
        """Return the task's name and the number of copies."""
        copies = f", {self.world.copies} copies" if self.world.leading else ""
        physics = np.round(1 / self.world.model.opt.timestep)
        control = f"{self.world.stepping} {self.world.frequency:g} Hz"
        return f"{type(self.task).__name__} in MuJoCo at {physics:g} Hz, {control}{copies}"
