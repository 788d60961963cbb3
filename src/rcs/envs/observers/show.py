"""Shows every step in a viewer."""

from __future__ import annotations

from rcs.envs.observer import Observer, Transition
from rcs.sim.viewer import Viewer


class Show(Observer):
    """Brings a viewer up to date after every step."""

    def __init__(self, viewer: Viewer) -> None:
        """Use an open viewer; it stays open when the environment is closed."""
        self._viewer = viewer

    def on_reset(self, first: Transition, seed: int | None) -> None:
        """Show the start."""
        self._viewer.sync()

    def on_step(self, transition: Transition) -> None:
        """Show the step."""
        self._viewer.sync()
