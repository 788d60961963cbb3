"""A simulated environment that goes on step by step while a person leads its robots."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from rcs_data.closing import Closing

from rcs.agents import Agent, agent_for
from rcs.devices import lookup
from rcs.envs.env import Env
from rcs.envs.setup import Setup
from rcs.envs.spaces import FRAMES, RGB, Action, Observation
from rcs.envs.step.judge import DIVERGED, FAULT
from rcs.errors import DeviceFault, RcsError
from rcs.rollout.interactive.guide import Guide
from rcs.setups.make import make, resolve
from rcs.sim.world import World


def playable(setup: Setup, *, keep_gripper: bool = False) -> Setup:
    """Return a setup for interactive use: at the rate of the wall clock, without a limit of steps.

    A gripper opens by degrees; a hand still opens and closes as a whole.

    Args:
        setup: The setup.
        keep_gripper: Keep the gripper commands of the setup, for an agent that was trained in it.

    Raises:
        UnknownName: The setup names something that is not there.
        InvalidSetup: Its parts do not fit each other.
    """
    has_hand = any(robot.hand is not None for robot in resolve(setup).robots)
    is_binary = setup.binary_gripper if keep_gripper else has_hand
    return replace(setup, stepping="realtime", max_episode_steps=None, binary_gripper=is_binary)


class Session(Closing):
    """Episodes of an environment, one after the other, used by one thread. A context manager.

    Errors of a step do not end it: `problem` has the message, and `recover` goes on.
    """

    def __init__(self, setup: Setup, *, seed: int = 0, agent: Any = None) -> None:
        """Make the environment and begin its first episode.

        Args:
            setup: The setup, as `playable` returns it, or with other timing in tests.
            seed: Seed of the first episode.
            agent: Agent that may act in place of the person, as `agent_for` takes it; None for the task's expert.

        Raises:
            UnknownName: The setup names something that is not there.
            InvalidSetup: Its parts do not fit each other, or a layer leaves actions that a person cannot make.
        """
        self.observation: Observation = {}
        """The present observation."""
        self.info: Mapping[str, Any] = {}
        """Info of the last step, or of the reset."""
        self._actor = agent
        self.env: Env = make(setup)
        try:
            self.guides: dict[str, Guide] = {name: Guide(self.env, robot) for name, robot in self.env.robots.items()}
            """The guide of each robot, by its name."""
            self.is_playing = True
            """Whether `advance` makes steps."""
            self.seed = seed
            """Seed of the present episode."""
            self.agent: Agent | None = None
            """The agent that acts in place of the person; None if the person does."""
            self._begin(seed, None)
        except BaseException:
            self.env.close()
            raise

    # --- State --------------------------------------------------------------------------------------------------------

    @property
    def setup(self) -> Setup:
        """The simulated setup."""
        return self.env.setup

    @property
    def world(self) -> World:
        """The simulated world."""
        return self.env.simulation.world

    @property
    def has_agent(self) -> bool:
        """True if there is an agent to act in place of the person."""
        return self._actor is not None or lookup.find("task", self.setup.task).expert is not None

    @property
    def frames(self) -> dict[str, Any]:
        """The last colour frames by camera, (H, W, 3) uint8."""
        return {name: frame[RGB] for name, frame in self.observation.get(FRAMES, {}).items()}

    @property
    def verdict(self) -> str:
        """State of the episode in one word: running, paused, stopped by an error, success, or over without it."""
        if self.problem:
            return "stopped"
        if self.is_over:
            return "success" if self.info.get("success", False) else "over"
        return "running" if self.is_playing else "paused"

    # --- Control ------------------------------------------------------------------------------------------------------

    def reset(self, seed: int | None = None) -> None:
        """Begin an episode.

        Args:
            seed: Seed of the episode; None for the one after the present one.

        Raises:
            RcsError: The environment cannot be reset; `problem` has the message, too.
        """
        self._begin(self.seed + 1 if seed is None else seed, None)

    def recover(self) -> None:
        """Clear faults and go on: from where everything is after a fault, anew after anything else.

        Raises:
            RcsError: It cannot go on; `problem` has the message, too.
        """
        self.env.recover()
        state = self.world.states() if self._is_fault else None
        self._begin(self.seed, state)

    def let_agent(self, is_acting: bool) -> None:
        """Let the agent act in a new episode with the present seed, or take over from it.

        Raises:
            InvalidSetup: There is no agent, and the task has no expert; or it does not fit the environment.
        """
        if is_acting:
            self.agent = agent_for(self.env, self._actor)
            self._begin(self.seed, None)
        else:
            self._end_agent()

    def step(self) -> None:
        """Make one step, of one control period, unless the episode is over."""
        if self.is_over:
            return
        try:
            step = self.env.step(self._action())
        except RcsError as err:
            self.problem, self.is_over = f"{type(err).__name__}: {err}", True
            self._is_fault = isinstance(err, DeviceFault)
            return
        self.observation, reward, terminated, truncated, self.info = step
        self.reward = float(reward)
        for guide in self.guides.values():
            guide.see(self.observation) if self.agent is None else guide.reset(self.observation)
        self.steps += 1
        self.total += self.reward
        self.is_over = terminated or truncated
        if faults := self.info.get("faults"):
            self.problem = "; ".join(f"{name}: {why}" for name, why in faults.items())
            self._is_fault = self.info["end"] == FAULT
        elif self.info["end"] == DIVERGED:
            self.problem, self._is_fault = "The simulation diverged.", False

    def advance(self) -> bool:
        """Make a step if the session is playing and the episode not over; return whether one was made."""
        if not self.is_playing or self.is_over:
            return False
        self.step()
        return True

    def _action(self) -> Action:
        if self.agent is not None:
            return self.agent.act(self.observation, self.info)
        actions = {name: guide.act(self.observation, self.info) for name, guide in self.guides.items()}
        return actions if len(actions) > 1 else next(iter(actions.values()))

    def _begin(self, seed: int, state: Any) -> None:
        self.problem = ""
        """Why the episode was stopped; empty if nothing is wrong."""
        self._is_fault = False
        self.is_over = True
        """Whether the episode is over, so that only `reset` and `recover` go on."""
        self.reward, self.total, self.steps = 0.0, 0.0, 0
        self.info = {}
        try:
            options = None if state is None or not np.isfinite(state).all() else {"state": state}
            self.observation, self.info = self.env.reset(seed=seed, options=options)
            self.seed = seed
            if self.agent is not None:
                self.agent.reset(self.observation, self.info)
        except RcsError as err:
            self.problem, self._is_fault = f"{type(err).__name__}: {err}", isinstance(err, DeviceFault)
            raise
        for guide in self.guides.values():
            guide.reset(self.observation)
        self.is_over = False

    def _end_agent(self) -> None:
        if self.agent is not None:
            self.agent.close()
            self.agent = None

    def close(self) -> None:
        """Close the environment. Closing twice is harmless."""
        self._end_agent()
        self.env.close()
