"""An agent for tests that need a robot in motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.agents import Agent
from rcs.envs.env import Env
from rcs.envs.spaces import JOINTS, Action, Observation


class JointSweep(Agent):
    """Sweeps each joint a little towards the middle of its range and back, slower from joint to joint.

    It is the smallest motion that shows how a robot follows.
    """

    def __init__(self, env: Env, *, amplitude: float = 0.3, period: float = 3.0) -> None:
        """Prepare to act in an environment with absolute joint actions.

        Args:
            env: The environment.
            amplitude: Range of each joint's motion [rad]; its speed is at most pi times this, divided by the period.
            period: Time of the first joint for one motion there and back [s]; the last takes twice as long.
        """
        self._env = env
        self._amplitude = amplitude
        self._period = period

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Begin at the present joints."""
        self._steps = 0
        self._starts = {name: np.array(self._part(observation, name)[JOINTS]) for name in self._env.robots}

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the next targets; grippers open."""
        self._steps += 1
        actions = {name: self._action(name) for name in self._env.robots}
        return actions if len(actions) > 1 else next(iter(actions.values()))

    def _action(self, name: str) -> Action:
        arm = self._env.robots[name].arm
        joints = self._starts[name]
        middle = (np.array(arm.joint_lower) + np.array(arm.joint_upper)) / 2
        periods = self._period * np.linspace(1.0, 2.0, arm.dof)
        share = (1.0 - np.cos(2 * np.pi * self._steps / self._env.frequency / periods)) / 2
        action: Action = {JOINTS: joints + self._amplitude * np.where(middle < joints, -1.0, 1.0) * share}
        own: Any = self._env.action_space
        for key, box in (own[name] if len(self._env.robots) > 1 else own).items():
            if key != JOINTS and isinstance(box, spaces.Box):
                action[key] = box.high.copy()
        return action

    def _part(self, observation: Observation, name: str) -> Mapping[str, NDArray[Any]]:
        return observation[name] if len(self._env.robots) > 1 else observation
