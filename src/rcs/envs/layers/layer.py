"""The interface of a layer, the f and g of the paper's wrapper W = <f, g, P', R'>.

A layer maps actions down (g, `map_action`) and observations up (f, `map_observation`). It uses no device and no clock;
arrays are indexed from the right, so that one layer serves one environment and a batch of any size.

A layer that remembers targets changes them in `map_executed`, `reset` and `rebase` only: `map_action` is also called
for actions that a lower layer refuses, which must leave no trace.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import EllipsisType
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.envs.spaces import XYZRPY, Action, Observation, xyzrpy_space
from rcs.errors import InvalidSetup

ActionSpaces = dict[str, spaces.Box]
"""Space of every key of an action."""

CopyIndex = EllipsisType | NDArray[np.integer]
"""Which copies a reset is for: `...` for all, or their numbers. Indexes the first axis of a batch."""

everywhere: CopyIndex = ...
"""All copies."""


class Layer:
    """A layer that changes nothing; subclasses override what they change."""

    memory: tuple[str, ...] = ()
    """Names of the attributes in which the layer remembers something, for the state of an environment. Each is an array
    (*leading, ...), None, a dictionary of such arrays, or an object that has a `memory` in turn."""

    def action_spaces(self, inner: ActionSpaces) -> ActionSpaces:
        """Return the spaces of the actions that the layer takes, given those of the level below."""
        return inner

    def observation_spaces(self, inner: Mapping[str, spaces.Space[Any]]) -> dict[str, spaces.Space[Any]]:
        """Return the spaces of the observations that the layer gives, given those of the level below."""
        return dict(inner)

    def reset(self, observation: Observation, where: CopyIndex = everywhere) -> None:
        """Forget the last episode of some copies.

        Args:
            observation: First observation of the new episode, as the level below gives it, of all copies.
            where: The copies whose episode is new.
        """

    def rebase(self, observation: Observation) -> None:
        """Make following actions count from the measured state; the episode goes on.

        Called after the devices were held, recovered or moved by somebody else. A layer that remembers targets replaces
        them by the measured state.

        Args:
            observation: Present observation, as the level below gives it.
        """

    def map_action(self, action: Action) -> Action:
        """Return the action of the level below; the argument and what the layer remembers stay as they are."""
        return action

    def map_executed(self, executed: Action) -> Action:
        """Return the executed action of this level, given that of the level below.

        Called when all devices have taken the action of the last `map_action`, from the lowest layer up: a layer that
        keeps a reference continues from here, and learns whether a target was limited.
        """
        return executed

    def map_observation(self, observation: Observation) -> Observation:
        """Return the observation of this level from that of the level below; the argument stays as it is."""
        return observation

    def info(self) -> dict[str, NDArray[Any]]:
        """Return the layer's info on the last action, one array per key with the batch's leading shape."""
        return {}

    def __str__(self) -> str:
        """Return the layer for the printed stack."""
        return type(self).__name__


def renew(old: NDArray[Any] | None, new: NDArray[Any], where: CopyIndex) -> NDArray[Any]:
    """Return `old` with the rows `where` taken from `new`; `new` if there is no old one."""
    if old is None or where is ...:
        return new.copy()
    kept = old.copy()
    kept[where] = new[where]
    return kept


def replaced(values: Mapping[str, Any], key: str, new_key: str, value: Any) -> dict[str, Any]:
    """Return values by key in which one key and its value are replaced, in the same place."""
    return {(new_key if own == key else own): (value if own == key else kept) for own, kept in values.items()}


def require_xyzrpy(layer: Layer, inner: ActionSpaces) -> None:
    """Check that a layer that changes `xyzrpy` relative to the last step is on top of it.

    Raises:
        InvalidSetup: The level below takes no `xyzrpy`, or absolute ones or those relative to an origin.
    """
    if XYZRPY not in inner or inner[XYZRPY] == xyzrpy_space():  # which has the bounds of both
        raise InvalidSetup(
            f"{layer} is on top of {', '.join(inner) or 'no actions'}; it needs control='xyzrpy' and "
            "relative='last_step'."
        )
