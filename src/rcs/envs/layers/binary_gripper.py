"""A gripper that is either open or closed."""

from __future__ import annotations

import numpy as np

from rcs.envs.layers.layer import Layer
from rcs.envs.spaces import GRIPPER, Action

THRESHOLD = 0.5
"""Actions of at least this open the gripper."""


class BinaryGripper(Layer):
    """Open the gripper fully for actions of at least 0.5, close it fully for others."""

    def map_action(self, action: Action) -> Action:
        """Round the gripper's action to 0 or 1."""
        return {**action, GRIPPER: (action[GRIPPER] >= THRESHOLD).astype(np.float32)}
