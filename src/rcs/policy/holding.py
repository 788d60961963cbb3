"""The action that moves nothing, in any control mode."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from rcs.envs.env import Env
from rcs.envs.spaces import GRIPPER, HAND, JOINTS, TQUAT, XYZRPY, Action, Observation
from rcs.policy.offer import flat_boxes, key_of
from rcs.policy.part import STILL, Array
from rcs.spatial import tquat_to_xyzrpy


class Holding:
    """Makes a robot stay where it is measured when it begins to hold; grippers keep what was commanded last.

    Differences of nothing count from the measured state after `Env.hold`, and absolute targets are the measured ones.
    """

    def __init__(self, env: Env) -> None:
        """Hold in an environment."""
        self._env = env
        self._boxes = dict(flat_boxes(env.action_space))
        self._is_absolute = env.setup.relative == "absolute"
        self._places: dict[str, Array] = {}
        self._openings: dict[str, Array] = {}
        self._was_moved = False

    @property
    def is_on(self) -> bool:
        """Whether the robot holds now."""
        return bool(self._places)

    def reset(self, observation: Observation) -> None:
        """Begin an episode; grippers are as they are measured."""
        self._places = {}
        self._was_moved = False
        own = flat(observation)
        self._openings = {name: own[name] for name in self._boxes if key_of(name) in (GRIPPER, HAND)}

    def moved(self, action: Mapping[str, Array]) -> None:
        """Take note of an action, by part, that was commanded."""
        self._places, self._was_moved = {}, True
        self._openings = {name: action[name] for name in self._openings}

    def action(self, observation: Observation) -> Action:
        """Return the action of holding; the devices are told to hold when it begins."""
        if not self._places:
            own = flat(observation)
            self._places = {name: self._place(name, own) for name in self._boxes}
            if self._was_moved:
                self._env.hold()
        return nested({**self._places, **self._openings}, self._boxes)

    def _place(self, name: str, measured: Mapping[str, Array]) -> Array:
        key = key_of(name)
        if name in self._openings:
            return self._openings[name]
        if self._is_absolute and key in (JOINTS, TQUAT, XYZRPY):
            if key == XYZRPY:
                return tquat_to_xyzrpy(measured[name[: -len(XYZRPY)] + TQUAT])
            return measured[name]
        return STILL if key == TQUAT else np.zeros(self._boxes[name].shape)


def flat(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return arrays by name, with `/` between the levels of dictionaries."""
    found: dict[str, Any] = {}
    for key, value in values.items():
        name = f"{prefix}/{key}" if prefix else key
        if isinstance(value, Mapping):
            found.update(flat(value, name))
        else:
            found[name] = value
    return found


def nested(values: Mapping[str, Array], boxes: Mapping[str, spaces.Box]) -> Action:
    """Return arrays by name as an action, inside the bounds."""
    action: Action = {}
    for name, box in boxes.items():
        robot, _, key = name.rpartition("/")
        value = np.clip(values[name], box.low, box.high).astype(box.dtype)
        (action.setdefault(robot, {}) if robot else action)[key] = value
    return action
