"""Bounds how far the target of the TCP runs ahead of an arm that is held up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rcs.envs.layers.layer import ActionSpaces, CopyIndex, Layer, everywhere, renew, require_xyzrpy
from rcs.envs.spaces import TQUAT, XYZRPY, Action, Observation

LAG = 4.0
"""Steps by which a moving arm may be behind: an FR3 at 0.5 m/s is, at 10 Hz, by 20 cm."""

AT_REST = 0.5
"""Actions by which the target may be ahead of an arm that stands: one in the other direction then moves it."""


class BoundLead(Layer):
    """Cut changes of `xyzrpy` that take the target's translation too far from where the TCP is.

    Along each axis, the target may be ahead by half an action, and by four times what the TCP moved in the last step.
    An action in the other direction starts from where the arm is, or as far ahead as its motion accounts for. A free
    arm starts a little later. One that presses on a table comes up with the first action that says so. Otherwise the
    target would sink in by what `LimitStep` allows, 30 cm and more, and nothing would happen for as many steps up
    again, which learners that act by chance never make. Put it on `xyzrpy` relative to the last step.
    """

    memory = ("_last", "_measured", "_before")

    def __init__(self) -> None:
        """Know no place yet."""
        self._last: NDArray[np.float64] | None = None
        self._measured: NDArray[np.float64] | None = None
        self._before: NDArray[np.float64] | None = None
        self._bound = np.zeros(6)

    def action_spaces(self, inner: ActionSpaces) -> ActionSpaces:
        """Return those of the level below.

        Raises:
            InvalidSetup: It takes no `xyzrpy` relative to the last step.
        """
        require_xyzrpy(self, inner)
        self._bound = inner[XYZRPY].high
        return inner

    def reset(self, observation: Observation, where: CopyIndex = everywhere) -> None:
        """Start from where the TCP is, at rest."""
        place = observation[TQUAT][..., :3]
        self._last = renew(self._last, place, where)
        self._before = renew(self._before, place, where)
        self._measured = place.copy()

    def rebase(self, observation: Observation) -> None:
        """Go on from where the TCP is, at rest."""
        self._last = self._before = self._measured = observation[TQUAT][..., :3].copy()

    def map_observation(self, observation: Observation) -> Observation:
        """Remember where the TCP is."""
        self._measured = observation[TQUAT][..., :3].copy()
        return observation

    def map_action(self, action: Action) -> Action:
        """Cut the translation; what is cut may also point back."""
        if self._last is None or self._measured is None or self._before is None:
            raise RuntimeError("BoundLead.map_action was called before reset")
        given = action[XYZRPY]
        bound = self._bound[:3]
        behind = LAG * np.abs(self._measured - self._before)
        ahead = self._last - self._measured
        turns = given[..., :3] * ahead < 0.0
        kept = np.where(turns, np.minimum(np.maximum(ahead, -behind), behind), ahead)
        furthest = behind + AT_REST * bound
        cut = np.minimum(np.maximum(kept + given[..., :3], -furthest), furthest) - ahead
        full = given.copy()
        full[..., :3] = np.minimum(np.maximum(cut, -bound), bound)
        return {**action, XYZRPY: full}

    def map_executed(self, executed: Action) -> Action:
        """Go on from what was sent."""
        self._last = executed[TQUAT][..., :3]
        self._before = self._measured
        return executed
