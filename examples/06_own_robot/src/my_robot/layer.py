"""A layer: `--layers HalfSpeed`, or `rcs.make(..., layers=["HalfSpeed"])`."""

from __future__ import annotations

from rcs.envs import Action, Layer


class HalfSpeed(Layer):
    """Halve relative actions."""

    def map_action(self, action: Action) -> Action:
        """Halve the step of every joint."""
        return {**action, "joints": 0.5 * action["joints"]}
