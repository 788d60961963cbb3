"""Actions that are differences instead of absolute targets."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from rcs._core import clip_rows
from rcs.envs.layers.layer import ActionSpaces, CopyIndex, Layer, everywhere, renew, replaced
from rcs.envs.spaces import JOINTS, ORIGIN, TQUAT, XYZRPY, Action, Control, Observation, require_direction, xyzrpy_space
from rcs.spatial import compose, distance, interpolate, normalize, xyzrpy_to_tquat

Reference = Literal["last_step", "origin"]
"""The reference of a relative action: the target of the last step, or an origin set by the user."""


LARGEST_TURN = 2.5
"""Largest rotation of one action [rad], however slow the control: nearer to a half turn, its sense is not certain."""


class Relative(Layer):
    """Take differences and pass on absolute targets.

    Joints add up. A pose difference moves the TCP by its translation along the axes of the base frame and turns it by
    its rotation about those axes; the quaternion of no rotation is (0, 0, 0, 1), and that of a difference to the last
    step has a positive last entry. The reference of `last_step` is the last *target*, so that servo lag does not
    accumulate.
    """

    memory = ("_reference", "_last")

    def __init__(
        self,
        control: Control,
        *,
        frequency: float,
        to: Reference = "last_step",
        joint_speed: ArrayLike = 2.5,
        translation_speed: float = 0.5,
        rotation_speed: float = 2.0,
    ) -> None:
        """Set the bounds of one action: speeds times the control period, so that every rate moves equally fast.

        Args:
            control: Key of the arm's action: `joints`, `tquat` or `xyzrpy`.
            frequency: Control steps per second [Hz].
            to: The reference of differences. The bounds hold for `last_step` alone.
            joint_speed: Largest joint speed [rad/s], a number or shape (dof,).
            translation_speed: Largest speed of the TCP along each axis [m/s].
            rotation_speed: Largest rotational speed of the TCP [rad/s].
        """
        self._control: Control = control
        self._to: Reference = to
        self._max_joint_step = np.asarray(joint_speed, np.float64) / frequency
        self._max_translation = translation_speed / frequency
        self._max_rotation = min(rotation_speed / frequency, LARGEST_TURN)
        self._key = JOINTS if control == JOINTS else TQUAT
        self._reference: NDArray[np.float64] | None = None
        self._last: NDArray[np.float64] | None = None
        self._lower: NDArray[np.float64] = np.zeros(0)
        self._upper: NDArray[np.float64] = np.zeros(0)

    def action_spaces(self, inner: ActionSpaces) -> ActionSpaces:
        """Replace the space of absolute targets by one of differences."""
        box = inner[self._key]
        self._lower, self._upper = box.low.astype(np.float64), box.high.astype(np.float64)
        if self._to == "origin":
            # Differences from an origin grow over an episode and may span the range of the absolute target.
            bound = {JOINTS: box.high - box.low, TQUAT: box.high, XYZRPY: xyzrpy_space().high}[self._control]
        elif self._control == JOINTS:
            bound = np.broadcast_to(self._max_joint_step, box.shape).astype(np.float64)
        elif self._control == TQUAT:
            bound = np.array([self._max_translation] * 3 + [np.sin(self._max_rotation / 2)] * 3 + [1.0])
        else:
            bound = np.array([self._max_translation] * 3 + [self._max_rotation] * 3)
        lower = -bound
        if self._control == TQUAT and self._to == "last_step":
            # The quaternion of a small rotation is the one near 1: every member of the space has a direction.
            lower[6] = np.cos(self._max_rotation / 2)
        difference = spaces.Box(lower, bound, dtype=np.float64)
        return replaced(inner, self._key, self._control, difference)

    def reset(self, observation: Observation, where: CopyIndex = everywhere) -> None:
        """Start from the measured joints or pose."""
        self._reference = renew(self._reference, observation[self._key], where)
        self._last = renew(self._last, observation[self._key], where)

    def rebase(self, observation: Observation) -> None:
        """Use the measured joints or pose as reference and origin."""
        self._reference = self._last = observation[self._key].copy()

    def info(self) -> dict[str, NDArray[Any]]:
        """Return the origin of differences to one: joints or pose."""
        return {} if self._to != "origin" or self._reference is None else {ORIGIN: self._reference}

    def set_origin(self) -> None:
        """Take the last target as the origin of all copies."""
        if self._last is None:
            raise RuntimeError("Relative.set_origin was called before reset")
        self._reference = self._last.copy()

    def map_action(self, action: Action) -> Action:
        """Add the difference to the reference, within the bounds of the level below.

        Raises:
            InvalidAction: A quaternion has no direction.
        """
        if self._reference is None or self._last is None:
            raise RuntimeError("Relative.map_action was called before reset")
        difference = action[self._control]
        if self._control == JOINTS:
            target = self._reference + difference
            if clip_rows(target, self._lower, self._upper, 0.0) is None:
                # A joint that was found outside its range may stay there, and goes no farther out.
                lower, upper = np.minimum(self._lower, self._last), np.maximum(self._upper, self._last)
                target = np.minimum(np.maximum(target, lower), upper)
        else:
            target = self._move(self._reference, difference)
        # Poses are returned as tquat, since this layer also converts xyzrpy.
        return replaced(action, self._control, self._key, target)

    def map_executed(self, executed: Action) -> Action:
        """Continue from the executed target of the level below, not from the requested one."""
        self._last = executed[self._key]
        if self._to == "last_step":
            self._reference = self._last
        return executed

    def _move(self, start: NDArray[np.float64], difference: NDArray[np.float64]) -> NDArray[np.float64]:
        step = xyzrpy_to_tquat(difference) if self._control == XYZRPY else difference
        require_direction(step)
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
