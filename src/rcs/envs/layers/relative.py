"""Actions that are differences instead of absolute targets."""

from __future__ import annotations

from typing import Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.envs.layers.layer import ActionSpaces, Layer, Where, everywhere, renew
from rcs.envs.spaces import JOINTS, TQUAT, XYZRPY, Action, Control, Observation, xyzrpy_space
from rcs.spatial import compose, distance, interpolate, normalize, xyzrpy_to_tquat

Reference = Literal["last_step", "origin"]
"""The reference of a relative action: the target of the last step, or an origin set by the user."""


class Relative(Layer):
    """Take differences and pass on absolute targets.

    Joints add up. A pose difference moves the TCP by its translation along the axes of the base frame and turns it by
    its rotation about those axes. The reference of `last_step` is the last *target*, so that servo lag does not
    accumulate.
    """

    memory = ("_reference", "_last")

    def __init__(
        self,
        control: Control,
        *,
        to: Reference = "last_step",
        max_joint_step: float | NDArray[np.float64] = np.deg2rad(5.0),
        max_translation: float = 0.05,
        max_rotation: float = np.deg2rad(15.0),
    ) -> None:
        """Set the bounds of one action.

        Args:
            control: Key of the arm's action: `joints`, `tquat` or `xyzrpy`.
            to: The reference of differences.
            max_joint_step: Largest joint difference [rad], a number or shape (dof,).
            max_translation: Largest translation along each axis [m].
            max_rotation: Largest rotation [rad].
        """
        self._control: Control = control
        self._to: Reference = to
        self._max_joint_step = max_joint_step
        self._max_translation = max_translation
        self._max_rotation = max_rotation
        self._key = JOINTS if control == JOINTS else TQUAT
        self._reference: NDArray[np.float64] | None = None
        self._last: NDArray[np.float64] | None = None
        self._lower = self._upper = np.zeros(0)

    def action_spaces(self, inner: ActionSpaces) -> ActionSpaces:
        """Replace the space of absolute targets by one of differences."""
        box = inner[self._key]
        self._lower, self._upper = box.low, box.high
        if self._to == "origin":
            # Differences from an origin grow over an episode and may span the range of the absolute target.
            bound = {JOINTS: box.high - box.low, TQUAT: box.high, XYZRPY: xyzrpy_space().high}[self._control]
        elif self._control == JOINTS:
            bound = np.broadcast_to(self._max_joint_step, box.shape).astype(np.float64)
        elif self._control == TQUAT:
            bound = np.array([self._max_translation] * 3 + [1.0] * 4)
        else:
            bound = np.array([self._max_translation] * 3 + [self._max_rotation] * 3)
        difference = spaces.Box(-bound, bound, dtype=np.float64)
        return {
            (self._control if key == self._key else key): (difference if key == self._key else value)
            for key, value in inner.items()
        }

    def reset(self, observation: Observation, where: Where = everywhere) -> None:
        """Start from the measured joints or pose."""
        self._reference = renew(self._reference, observation[self._key], where)
        self._last = renew(self._last, observation[self._key], where)

    def rebase(self, observation: Observation) -> None:
        """Use the measured joints or pose as reference and origin."""
        self._reference = self._last = observation[self._key].copy()

    def set_origin(self) -> None:
        """Take the last target as the origin of all copies."""
        if self._last is None:
            raise RuntimeError("Relative.set_origin was called before reset")
        self._reference = self._last.copy()

    def map_action(self, action: Action) -> Action:
        """Add the difference to the reference, within the bounds of the level below."""
        if self._reference is None:
            raise RuntimeError("Relative.map_action was called before reset")
        difference = action[self._control]
        if self._control == JOINTS:
            target = np.minimum(np.maximum(self._reference + difference, self._lower), self._upper)
        else:
            target = self._move(self._reference, difference)
        mapped: Action = {key: value for key, value in action.items() if key != self._control}
        # Poses are returned as tquat, since this layer also converts xyzrpy.
        mapped[self._key] = target
        return mapped

    def map_executed(self, executed: Action) -> Action:
        """Continue from the executed target of the level below, not from the requested one."""
        self._last = executed[self._key]
        if self._to == "last_step":
            self._reference = self._last
        return executed

    def _move(self, start: NDArray[np.float64], difference: NDArray[np.float64]) -> NDArray[np.float64]:
        step = xyzrpy_to_tquat(difference) if self._control == XYZRPY else difference
        return shift(start, step, self._max_rotation if self._to == "last_step" else np.inf)

    def __str__(self) -> str:
        """Return the layer for the printed stack."""
        return f"Relative({self._control} to the {self._to.replace('_', ' ')})"


def shift(start: NDArray[np.float64], step: NDArray[np.float64], max_rotation: float = np.inf) -> NDArray[np.float64]:
    """Move poses along and turn them about the axes of their parent frame.

    Args:
        start: Poses (..., 7).
        step: Differences (..., 7): translation [m], rotation xyzw (normalised here).
        max_rotation: Limit to which larger rotations are clipped [rad].

    Returns:
        Poses (..., 7) with translation `start + step` and rotation `step * start`.
    """
    turn = np.zeros_like(step)
    turn[..., 3:] = normalize(step)[..., 3:]
    if np.isfinite(max_rotation):
        identity = np.zeros_like(step)
        identity[..., 6] = 1.0
        angle = distance(identity, turn)[..., 1]
        fraction = np.minimum(1.0, max_rotation / np.maximum(angle, 1e-12))
        if (fraction < 1.0).any():
            turn = interpolate(identity, turn, fraction)
    turned = np.zeros_like(start)
    turned[..., 3:] = start[..., 3:]
    moved = compose(turn, turned)
    moved[..., :3] = start[..., :3] + step[..., :3]
    return moved
