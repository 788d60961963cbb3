"""Poses as translation and roll, pitch, yaw instead of a quaternion."""

from __future__ import annotations

from rcs.envs.layers.layer import ActionSpaces, Layer
from rcs.envs.spaces import TQUAT, XYZRPY, Action, xyzrpy_space
from rcs.spatial import xyzrpy_to_tquat


class XyzrpyControl(Layer):
    """Take `xyzrpy` actions and pass them on as `tquat`."""

    def action_spaces(self, inner: ActionSpaces) -> ActionSpaces:
        """Replace `tquat` by `xyzrpy`."""
        return {
            (XYZRPY if key == TQUAT else key): (xyzrpy_space() if key == TQUAT else box) for key, box in inner.items()
        }

    def map_action(self, action: Action) -> Action:
        """Convert the pose."""
        return {
            (TQUAT if key == XYZRPY else key): (xyzrpy_to_tquat(value) if key == XYZRPY else value)
            for key, value in action.items()
        }
