"""Agents that act regardless of observations: recorded actions, and a sweep of the joints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.agents.agent import Agent
from rcs.envs.env import Env
from rcs.envs.spaces import JOINTS, Action, Observation
from rcs.errors import InvalidSetup, WrongOrder


class Replay(Agent):
    """Returns the actions of a recorded episode one after the other, regardless of observations."""

    def __init__(self, actions: Mapping[str, Any]) -> None:
        """Take the actions.

        Args:
            actions: One array (steps, ...) per key; with several robots, such a dictionary per robot.
        """
        self._actions = dict(actions)
        self._length = min(_lengths(self._actions), default=0)
        self._next = 0

    def __len__(self) -> int:
        """Return the number of steps."""
        return self._length

    def reset(self, observation: Observation, info: Mapping[str, Any]) -> None:
        """Start at the first action."""
        self._next = 0

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """Return the next recorded action.

        Raises:
            WrongOrder: All actions were played.
        """
        if self._next >= self._length:
            raise WrongOrder(f"All {self._length} recorded actions were played; call reset to start again.")
        self._next += 1
        return _row(self._actions, self._next - 1)


def _lengths(actions: Mapping[str, Any]) -> Iterator[int]:
    for value in actions.values():
        if isinstance(value, Mapping):
            yield from _lengths(value)
        else:
            yield len(value)


def _row(actions: Mapping[str, Any], i: int) -> Action:
    return {key: _row(value, i) if isinstance(value, Mapping) else value[i] for key, value in actions.items()}


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

        Raises:
            InvalidSetup: Actions are not absolute joints, or a number is not positive.
        """
        if env.setup.control != JOINTS or env.setup.relative != "absolute":
            raise InvalidSetup(
                f"A sweep of the joints needs control='joints' and relative='absolute', not {env.setup.control!r} and "
                f"{env.setup.relative!r}."
            )
        if not (amplitude > 0 and period > 0):
            raise InvalidSetup(f"amplitude is {amplitude} rad and period {period} s; valid are positive numbers.")
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
