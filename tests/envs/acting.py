"""Actions that tests send: one that stays, and one that moves, in any control mode."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.envs.env import Env
from rcs.envs.layers import Relative, TwistControl
from rcs.envs.spaces import GRIPPER, HAND, JOINTS, TQUAT, TWIST
from rcs.envs.step.chain import Chain

Action = dict[str, Any]


def stay(env: Env, observation: Mapping[str, Any]) -> Action:
    """Return an action that says "stay": no difference, or the measured pose or joints."""
    return _act(env, observation, moves=False)


def go(env: Env, observation: Mapping[str, Any]) -> Action:
    """Return an action that moves the first joint, or the TCP sideways, as far as one action may."""
    return _act(env, observation, moves=True)


def joints_of(env: Env) -> dict[str, NDArray[np.float64]]:
    """Return the measured joints of every robot [rad], by its name."""
    measured = env.stack.measure()
    return {name: np.array(measured[name][JOINTS]) for name in chains_of(env)}


def lift(env: Env) -> Any:
    """Return the present observation of the highest level."""
    return env.stack.lift(env.stack.measure())


def chains_of(env: Env) -> dict[str, Chain]:
    """Return the chains of an environment that take actions, by name."""
    return {name: chain for name, chain in env.stack.chains.items() if chain.action_spaces}


def _act(env: Env, observation: Mapping[str, Any], *, moves: bool) -> Action:
    action = {
        name: _act_of_one(stack, observation[name] if name else observation, moves=moves)
        for name, stack in chains_of(env).items()
    }
    return action.get("", action)


def _act_of_one(stack: Chain, observation: Mapping[str, Any], *, moves: bool) -> Action:
    is_relative = any(isinstance(layer, Relative | TwistControl) for layer in stack.layers)
    action: Action = {}
    for key, box in stack.action_spaces.items():
        assert isinstance(box, spaces.Box)
        if key in (GRIPPER, HAND):
            value = np.round(observation[key]) if key == GRIPPER else np.array(observation[key])
        elif key == JOINTS:
            value = np.zeros(box.shape) if is_relative else np.array(observation[JOINTS])
            if moves:
                value[0] = min(box.high[0], 0.2) if is_relative else value[0] + 0.5
        else:
            nothing = np.array([0.0] * 6 + [1.0]) if key == TQUAT else np.zeros(box.shape)
            value = nothing if is_relative else np.array(observation[key])
            if moves:
                value[1] += box.high[1] if key == TWIST else 0.05
        action[key] = np.clip(value, box.low, box.high).astype(box.dtype)
    return action
