"""An agent that sways every joint a little: the smallest motion that shows how a robot follows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.agents.agent import Agent
from rcs.envs.env import Env
from rcs.envs.spaces import JOINTS, Action, Observation
from rcs.errors import InvalidSetup


class Sway(Agent):
    """Moves each joint from where it stands towards the middle of its range and back, slower from joint to joint."""

    def __init__(self, env: Env, *, amplitude: float = 0.3, period: float = 3.0) -> None:
        """Prepare to act in an environment with absolute joint actions.

        Args:
            env: The environment.
            amplitude: How far each joint goes [rad]; its speed is at most pi times this, divided by the period.
            period: Time for one way there and back of the first joint [s]; the last takes twice as long.

        Raises:
            InvalidSetup: Actions are not absolute joints, or a number is not positive.
        """
        if env.setup.control != JOINTS or env.setup.relative != "absolute":
            raise InvalidSetup("Swaying needs control='joints' and relative=False.")
        if not (amplitude > 0 and period > 0):
            raise InvalidSetup(f"amplitude is {amplitude} rad and period {period} s; valid are positive numbers.")
        self._env = env
        self._amplitude = amplitude
        self._period = period

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Begin where the robots stand."""
        self._steps = 0
        self._starts = {name: np.array(self._part(observation, name)[JOINTS]) for name in self._env.robots}

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the next targets; grippers are opened."""
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
