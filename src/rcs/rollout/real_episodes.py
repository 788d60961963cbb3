"""Episodes with real robots: their starts, the agent's knowledge of the objects, and the verdict.

The objects lie where a simulated scene of the same setup has them at the episode's seed. Nothing is simulated after
that: the agent gets their poses at the start.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rcs.agents import Agent
from rcs.agents.agent import Event
from rcs.agents.script import Script
from rcs.envs.assemble import compose
from rcs.envs.env import Env
from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.setup import Setup
from rcs.envs.spaces import GRIPPER, JOINTS, Action, Observation
from rcs.envs.step.approach import SPEED
from rcs.envs.step.simulation import Simulation
from rcs.errors import DeviceFault
from rcs.rollout.episode import EpisodeResult, run_episode
from rcs.rollout.operator import Operator
from rcs.setups.make import resolve
from rcs.sim.robot import SimRobot
from rcs.sim.world import World

HOLDING = 1.0
"""Time that a script holds its last goal if its task has no hold time [s]."""
MORE = 0.5
"""Additional time [s]: a verdict looks once per step, and objects settle."""


class RealEpisodes:
    """Makes episodes in an environment with real arms."""

    def __init__(self, env: Env, agent: Agent, operator: Operator, *, speed: float = SPEED) -> None:
        """Prepare; nothing moves.

        Args:
            env: The environment.
            agent: The agent.
            operator: Agrees to motions, places the objects and judges.
            speed: Largest speed of a joint on its way home, as a share of its limit.
        """
        self._env, self._operator, self._speed = env, operator, speed
        self._scene = _scene_of(env.setup)
        holding = float(getattr(self._scene.task.options, "hold_time", HOLDING)) + MORE
        self._agent = _Informed(agent, holding)
        self.objects: dict[str, list[float]] = {}
        """Poses of the objects at the start of the present episode, for its outcome."""

    def prepare(self, seed: int) -> None:
        """Move the arms home, open their grippers, and let the operator place the objects.

        Raises:
            Refused: The operator does not agree that the arms move.
            DeviceFault: A device is in its fault state, and the operator does not agree to clear it.
        """
        self._scene.begin(EpisodeRandom(np.asarray(seed), np.asarray(0)))
        poses = self._scene.object_poses()
        self.objects = {name: pose.tolist() for name, pose in poses.items()}
        self._agent.known = self._scene.describe()
        self._go_home(seed)
        self._operator.place(seed, poses)

    def run(self, seed: int) -> EpisodeResult:
        """Make the episode that was prepared."""
        return run_episode(self._env, self._agent, seed=seed, judge=self._operator.judge)

    def _go_home(self, seed: int) -> None:
        home: dict[str, dict[str, Any]] = {}
        for name, robot in self._env.robots.items():
            home[name] = {JOINTS: np.array(robot.arm.home)}
            if robot.gripper is not None:
                home[name][GRIPPER] = np.ones(1)
        robot = home if len(home) > 1 else next(iter(home.values()))
        options = {"robot": robot, "may_move": self._operator.may_move, "speed": self._speed}
        while True:
            try:
                self._env.reset(seed=seed, options=options)
                return
            except DeviceFault as err:
                if not self._operator.may_recover(str(err)):
                    raise
                self._env.recover()

    def close(self) -> None:
        """Close the simulated scene."""
        self._scene.world.close()


class _Informed(Agent):
    """An agent with the objects' poses at the start; a script also stops when it is over."""

    def __init__(self, agent: Agent, holding: float) -> None:
        self._agent, self._holding = agent, holding
        self.rate = agent.rate
        self.known: Mapping[str, Any] = {}

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        self._agent.reset(observation, {**info, **self.known})

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        return self._agent.act(observation, {**info, **self.known})

    def close(self) -> None:
        self._agent.close()

    @property
    def failure(self) -> str | None:
        return self._agent.failure

    @property
    def failure_message(self) -> str | None:
        return self._agent.failure_message

    def notes(self) -> Mapping[str, Any]:
        return self._agent.notes()

    def events(self) -> Sequence[Event]:
        is_over = isinstance(self._agent, Script) and self._agent.is_over(self._holding)
        return [*self._agent.events(), *(("stop",) if is_over else ())]


def has_real_arms(env: Env) -> bool:
    """Return whether any arm of an environment is real."""
    return any(env.platform.get(name) != "simulation" for name in env.robots)


def _scene_of(setup: Setup) -> Simulation:
    """Return the simulated scene of a setup, as the robots' lab has it, without cameras."""
    bare = Setup(task=setup.task, task_options=setup.task_options, robot=setup.robot, end_effector=setup.end_effector)
    parts = resolve(replace(bare, frequency=setup.frequency))
    world = World(compose(parts).compile(), frequency=setup.frequency)
    return Simulation(world, [SimRobot(world, robot) for robot in parts.robots], parts.task)
