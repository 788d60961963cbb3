"""A hand with many joints, used like a gripper: open, or in one of its grasps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from rcs.envs.layers.binary_gripper import THRESHOLD
from rcs.envs.layers.layer import ActionSpaces, Layer
from rcs.envs.spaces import GRIPPER, HAND, Action, Observation, normalised_space


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
        return {
            (GRIPPER if key == HAND else key): (normalised_space(1) if key == HAND else box)
            for key, box in inner.items()
        }

    def observation_spaces(self, inner: Mapping[str, spaces.Space[Any]]) -> dict[str, spaces.Space[Any]]:
        """Add `gripper`."""
        return {**inner, GRIPPER: normalised_space(1)}

    def map_action(self, action: Action) -> Action:
        """Choose the pose."""
        hand = np.where(action[GRIPPER] >= THRESHOLD, self._open, self._grasp)
        mapped = {key: value for key, value in action.items() if key != GRIPPER}
        mapped[HAND] = hand
        return mapped

    def map_executed(self, executed: Action) -> Action:
        """Return which of the two poses was executed."""
        is_open = (executed[HAND] == self._open).all(axis=-1, keepdims=True).astype(np.float32)
        mapped = {key: value for key, value in executed.items() if key != HAND}
        mapped[GRIPPER] = is_open
        return mapped

    def map_observation(self, observation: Observation) -> Observation:
        """Add the opening of the hand."""
        # In a fixed order, unlike a matrix product or sum: copies must have the bits of a single environment.
        along = np.add.accumulate((observation[HAND] - self._grasp) * self._along, axis=-1)[..., -1]
        return {**observation, GRIPPER: np.clip(along, 0.0, 1.0)[..., None].astype(np.float32)}
