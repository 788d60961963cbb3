"""A gripper that is either open or closed."""

from __future__ import annotations

import numpy as np

from rcs.envs.layers.layer import Layer
from rcs.envs.spaces import GRIPPER, Action

THRESHOLD = 0.5
"""An action of at least this opens."""


class BinaryGripper(Layer):
    """Open the gripper fully for an action of 0.5 and more, close it fully for less."""

    def map_action(self, action: Action) -> Action:
        """Round the gripper's action to 0 or 1."""
        return {**action, GRIPPER: (action[GRIPPER] >= THRESHOLD).astype(np.float32)}
