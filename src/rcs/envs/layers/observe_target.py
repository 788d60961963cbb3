"""The arm's last target as an observation: relative actions count from it, not from the pose that is measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.envs.layers.layer import ActionSpaces, CopyIndex, Layer, everywhere, renew
from rcs.envs.spaces import JOINTS, TARGET, TQUAT, Action, Observation, tquat_space


class ObserveTarget(Layer):
    """Add `target`/`tquat`, the TCP pose of the last target, or on control by joints `target`/`joints`.

    A moving arm is behind its target, by up to 20 cm at full speed. A learner with actions relative to the last target
    that does not know it overshoots.
    """

    memory = ("_target",)

    def __init__(self) -> None:
        """Know no target yet."""
        self._target: NDArray[np.float64] | None = None
        self._key = TQUAT

    def action_spaces(self, inner: ActionSpaces) -> ActionSpaces:
        """Return the actions of the level below; they say what a target is."""
        self._key = JOINTS if JOINTS in inner else TQUAT
        return inner

    def observation_spaces(self, inner: Mapping[str, spaces.Space[Any]]) -> dict[str, spaces.Space[Any]]:
        """Add the key."""
        return {**inner, TARGET: spaces.Dict({self._key: inner[JOINTS] if self._key == JOINTS else tquat_space()})}

    def reset(self, observation: Observation, where: CopyIndex = everywhere) -> None:
        """Start with what is measured."""
        self._target = renew(self._target, observation[self._key], where)

    def rebase(self, observation: Observation) -> None:
        """Go on from what is measured."""
        self._target = observation[self._key].copy()

    def map_executed(self, executed: Action) -> Action:
        """Remember what was sent."""
        self._target = executed[self._key]
        return executed

    def map_observation(self, observation: Observation) -> Observation:
        """Add the target."""
        target = observation[self._key] if self._target is None else self._target
        return {**observation, TARGET: {self._key: target.copy()}}
