"""A layer of our own: `--layers HalfSpeed`, or `rcs.make(..., layers=["HalfSpeed"])`."""

from __future__ import annotations

from rcs.envs.layers import Action, Layer
from rcs.envs.spaces import JOINTS


class HalfSpeed(Layer):
    """Go half as far as a relative action says."""

    def map_action(self, action: Action) -> Action:
        """Halve the step of every joint."""
        return {**action, JOINTS: 0.5 * action[JOINTS]}
