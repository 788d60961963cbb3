"""The arm's last target as an observation: relative actions count from it, not from the pose that is measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.envs.layers.layer import ActionSpaces, Layer, Where, everywhere, renew
from rcs.envs.spaces import JOINTS, TARGET, TQUAT, Action, Observation, tquat_space
from rcs.errors import InvalidSetup


class ObserveTarget(Layer):
    """Add `target`/`tquat`, the TCP pose of the last target.

    A moving arm is behind its target, by up to 20 cm at full speed. A learner with actions relative to the last target
    that does not know it overshoots. Put this layer on Cartesian control.
    """

    memory = ("_target",)

    def __init__(self) -> None:
        """Know no target yet."""
        self._target: NDArray[np.float64] | None = None

    def action_spaces(self, inner: ActionSpaces) -> ActionSpaces:
        """Check that there is a target pose; the actions are those of the level below.

        Raises:
            InvalidSetup: The arm is controlled by joints.
        """
        if JOINTS in inner:
            raise InvalidSetup(
                "ObserveTarget is on joints, which have no target pose; use control='tquat' or 'xyzrpy'."
            )
        return inner

    def observation_spaces(self, inner: Mapping[str, spaces.Space[Any]]) -> dict[str, spaces.Space[Any]]:
        """Add the key."""
        return {**inner, TARGET: spaces.Dict({TQUAT: tquat_space()})}

    def reset(self, observation: Observation, where: Where = everywhere) -> None:
        """Start with the measured pose."""
        self._target = renew(self._target, observation[TQUAT], where)

    def rebase(self, observation: Observation) -> None:
        """Go on from the measured pose."""
        self._target = observation[TQUAT].copy()

    def map_executed(self, executed: Action) -> Action:
        """Remember what was sent."""
        self._target = executed[TQUAT]
        return executed

    def map_observation(self, observation: Observation) -> Observation:
        """Add the pose."""
        target = observation[TQUAT] if self._target is None else self._target
        return {**observation, TARGET: {TQUAT: target.copy()}}
