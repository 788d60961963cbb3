"""Noise on relative actions, below what is recorded: demonstrations that show how an agent comes back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.envs.layers.layer import ActionSpaces, CopyIndex, Layer, everywhere, renew
from rcs.envs.spaces import JOINTS, TWIST, XYZRPY, XYZYAW, Action, Observation
from rcs.errors import InvalidSetup
from rcs.sim.splitmix import GAMMA, mix, units

ARM = (JOINTS, XYZRPY, XYZYAW, TWIST)
"""Keys of an arm's action that noise can be added to."""
DEVIATION = 0.12
"""Standard deviation of the noise, as a share of the largest action."""
KEPT = 0.7
"""Share of the noise that is left in the next step."""
MOST = 2.0
"""Largest motion in a step, and speed, of a relative action of a TCP [m, rad, m/s, rad/s]."""
STRETCH, DISTURBED = 8, 0.6
"""Steps in which noise comes or does not, and the share of such stretches in which it does."""


class DisturbActions(Layer):
    """Add noise to an arm's actions relative to the last step, so that an agent has to correct itself.

    A recording above has what the agent wanted as the action, and what was done as `executed`; a policy that learns the
    former knows how to come back from states that the agent alone never gets into (DART: Laskey et al. 2017,
    arXiv:1703.09327). Noise is drawn from the first observation of an episode, so that the same seed gives the same
    one; it is autoregressive, and rests in some stretches. Put it above all others.
    """

    memory = ("_keys", "_steps", "_noise")

    def __init__(self) -> None:
        """Know no action yet."""
        self._key = JOINTS
        self._bound = np.zeros(0)
        self._keys: NDArray[np.uint64] = np.zeros((), np.uint64)
        self._steps: NDArray[np.int64] = np.zeros((), np.int64)
        self._noise: NDArray[np.float64] | None = None
        self._next: NDArray[np.float64] | None = None

    def action_spaces(self, inner: ActionSpaces) -> ActionSpaces:
        """Take the same actions.

        Raises:
            InvalidSetup: The arm's action is none that noise can be added to.
        """
        found = next((key for key in ARM if key in inner), None)
        if found is None:
            raise InvalidSetup(f"DisturbActions adds noise to {', '.join(ARM)}; the actions are {', '.join(inner)}.")
        self._key, self._bound = found, inner[found].high
        return inner

    def observation_spaces(self, inner: Mapping[str, spaces.Space[Any]]) -> dict[str, spaces.Space[Any]]:
        """Look how far joints can go; the observations are those of the level below.

        Raises:
            InvalidSetup: The actions are absolute, or relative to an origin.
        """
        joints: Any = inner[JOINTS]
        farthest = 0.25 * (joints.high - joints.low) if self._key == JOINTS else MOST  # half of what may be asked for
        if (self._bound >= farthest).any():
            raise InvalidSetup(
                "DisturbActions adds noise to actions relative to the last step, and these are absolute or relative to "
                "an origin; give relative='last_step'."
            )
        return dict(inner)

    def reset(self, observation: Observation, where: CopyIndex = everywhere) -> None:
        """Draw the noise of new episodes."""
        leading = observation[JOINTS].shape[:-1]
        keys = _hash(observation, np.zeros(leading, np.uint64))
        fresh = self._noise is None
        self._keys = renew(None if fresh else self._keys, keys, where)
        self._steps = renew(None if fresh else self._steps, np.zeros(leading, np.int64), where)
        self._noise = renew(self._noise, np.zeros((*leading, len(self._bound))), where)

    def map_action(self, action: Action) -> Action:
        """Add the noise, within the bounds."""
        if self._noise is None:
            raise RuntimeError("DisturbActions.map_action was called before reset")
        comes = units(self._bits(self._steps // STRETCH, 0)) < DISTURBED
        # Two uniform numbers make a normal one (Box and Muller 1958).
        drawn = units(self._bits(self._steps, 1, 2 * len(self._bound)))
        radius = np.sqrt(-2.0 * np.log1p(-drawn[..., 0::2]))
        white = radius * np.cos(2.0 * np.pi * drawn[..., 1::2]) * comes[..., None]
        self._next = KEPT * self._noise + np.sqrt(1.0 - KEPT**2) * DEVIATION * self._bound * white
        disturbed = np.clip(action[self._key] + self._next, -self._bound, self._bound)
        return {**action, self._key: disturbed}

    def map_executed(self, executed: Action) -> Action:
        """Go on with the next noise."""
        if self._next is None:
            raise RuntimeError("DisturbActions.map_executed was called before map_action")
        self._noise, self._steps = self._next, self._steps + 1
        return executed

    def _bits(self, counter: NDArray[np.int64], stream: int, count: int = 0) -> NDArray[np.uint64]:
        """Return random bits of a step, (*leading,) or (*leading, count)."""
        with np.errstate(over="ignore"):
            keys = mix(self._keys + np.uint64(stream) * GAMMA) + (counter + 1).astype(np.uint64) * GAMMA
            return mix(keys) if not count else mix(mix(keys)[..., None] + np.arange(count, dtype=np.uint64) * GAMMA)


def _hash(observation: Mapping[str, Any], keys: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return numbers that depend on all of an observation's numbers in float64, (*leading,)."""
    for value in observation.values():
        if isinstance(value, Mapping):
            keys = _hash(value, keys)
        elif isinstance(value, np.ndarray) and value.dtype == np.float64 and value.ndim == keys.ndim + 1:
            for word in np.moveaxis(np.ascontiguousarray(value).view(np.uint64), -1, 0):
                with np.errstate(over="ignore"):
                    keys = mix(keys ^ word) + GAMMA
    return keys
