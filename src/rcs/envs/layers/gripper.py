"""Grippers and hands that are either open or closed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.envs.layers.layer import ActionSpaces, Layer, replaced
from rcs.envs.spaces import GRIPPER, HAND, Action, Observation, normalised_space

THRESHOLD = 0.5
"""Actions of at least this open the gripper."""


class BinaryGripper(Layer):
    """Open the gripper fully for actions of at least 0.5, close it fully for others."""

    def map_action(self, action: Action) -> Action:
        """Round the gripper's action to 0 or 1."""
        return {**action, GRIPPER: (action[GRIPPER] >= THRESHOLD).astype(np.float32)}


class GraspHand(Layer):
    """Take `gripper` actions, 0.5 and more for the open hand, less for the grasp, and pass on `hand` targets.

    The observation also gets `gripper`: the progress of the joints from the grasp (0) to the open hand (1).
    """

    def __init__(self, open_pose: Sequence[float], grasp: Sequence[float]) -> None:
        """Use two poses of a hand.

        Args:
            open_pose: Normalised joints of the open hand.
            grasp: Normalised joints of the closed hand.
        """
        self._open = np.array(open_pose, np.float32)
        self._grasp = np.array(grasp, np.float32)
        way = self._open - self._grasp
        # Not by BLAS, whose last bit may depend on the array's place in memory.
        self._along = way / np.float32(max(sum(float(part) ** 2 for part in way), 1e-12))

    def action_spaces(self, inner: ActionSpaces) -> ActionSpaces:
        """Replace `hand` by `gripper`."""
        return replaced(inner, HAND, GRIPPER, normalised_space(1))

    def observation_spaces(self, inner: Mapping[str, spaces.Space[Any]]) -> dict[str, spaces.Space[Any]]:
        """Add `gripper`."""
        return {**inner, GRIPPER: normalised_space(1)}

    def map_action(self, action: Action) -> Action:
        """Choose the pose."""
        return replaced(action, GRIPPER, HAND, np.where(action[GRIPPER] >= THRESHOLD, self._open, self._grasp))

    def map_executed(self, executed: Action) -> Action:
        """Return which of the two poses was executed, or is nearer to what was."""
        is_open = self._opening(executed[HAND]) >= THRESHOLD
        return replaced(executed, HAND, GRIPPER, is_open.astype(np.float32))

    def map_observation(self, observation: Observation) -> Observation:
        """Add the opening of the hand."""
        return {**observation, GRIPPER: self._opening(observation[HAND])}

    def _opening(self, hand: NDArray[np.float32]) -> NDArray[np.float32]:
        # In a fixed order, unlike a matrix product or sum: copies must have the bits of a single environment.
        along = np.add.accumulate((hand - self._grasp) * self._along, axis=-1)[..., -1]
        return np.clip(along, 0.0, 1.0)[..., None].astype(np.float32)
