"""Bounds how far a joint target may run ahead, whatever its source."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs._core import limit_rows
from rcs.envs.layers.layer import CopyIndex, Layer, everywhere, renew
from rcs.envs.spaces import JOINTS, Action, Observation

ROUNDING = 1e-9
"""A target reduced by less than this [rad] counts as unlimited."""

FOUND_OUTSIDE = 0.02
"""A joint farther outside its range than this [rad] was found there; others were carried there by their servos."""


class LimitStep(Layer):
    """Bound every joint target against the last target and against the measured joints.

    The first bound is the joint velocity limit times the control period. The second keeps the target from running away
    while the arm is blocked. To a target farther away all joints go the same share of the way, so that the TCP keeps
    its direction; a joint that is blocked at the end of its lead stops them all. What brings a target back towards the
    measured joint is not bounded: an arm that is to turn round brakes at once. `info["is_limited"]` reports cuts.
    """

    memory = ("_target", "_measured", "_is_cut", "_is_limited")

    def __init__(
        self,
        max_step: NDArray[np.float64],
        max_lead: NDArray[np.float64] | float,
        *,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        max_return: float = np.inf,
    ) -> None:
        """Set the bounds.

        Args:
            max_step: Largest change of the target per action [rad], shape (dof,).
            max_lead: Largest distance of the target from the measured joint [rad], shape (dof,), or one for all; see
                `MotionLimits.lead`. With less, the arm cannot come to its full speed.
            lower: Lower end of the range of each joint [rad], shape (dof,), or one for all.
            upper: Upper end of the range.
            max_return: Largest change of a target that is outside of it, per action [rad].
        """
        self.max_step = np.asarray(max_step, np.float64)
        shape = self.max_step.shape
        self._bounds = (
            self.max_step,
            np.broadcast_to(np.asarray(max_lead, np.float64), shape).copy(),
            np.broadcast_to(np.asarray(lower, np.float64) - FOUND_OUTSIDE, shape).copy(),
            np.broadcast_to(np.asarray(upper, np.float64) + FOUND_OUTSIDE, shape).copy(),
            float(max_return),
            ROUNDING,
        )
        self._target: NDArray[np.float64] | None = None
        self._measured: NDArray[np.float64] | None = None
        self._is_cut: NDArray[np.bool_] = np.zeros((), np.bool_)  # by the last map_action
        self._is_limited: NDArray[np.bool_] = np.zeros((), np.bool_)

    def reset(self, observation: Observation, where: CopyIndex = everywhere) -> None:
        """Start from the measured joints."""
        measured: NDArray[np.float64] = observation[JOINTS].copy()
        self._measured = measured
        never = np.zeros(measured.shape[:-1], np.bool_)
        self._is_limited = renew(None if self._target is None else self._is_limited, never, where)
        self._target = renew(self._target, measured, where)

    def rebase(self, observation: Observation) -> None:
        """Bound the next target against the measured joints alone."""
        self._measured = self._target = observation[JOINTS].copy()

    def map_observation(self, observation: Observation) -> Observation:
        """Remember the measured joints; the observation belongs to the caller."""
        self._measured = observation[JOINTS].copy()
        return observation

    def map_action(self, action: Action) -> Action:
        """Cut the joint targets."""
        if self._target is None or self._measured is None:
            raise RuntimeError("LimitStep.map_action was called before reset")
        asked = action[JOINTS]
        cut = limit_rows(asked, self._target, self._measured, *self._bounds)
        if cut is None:
            # Returning the same array shows the layers above that nothing was cut.
            self._is_cut = np.zeros(self._is_limited.shape, np.bool_)
            return action
        target, self._is_cut = cut
        return {**action, JOINTS: target}

    def map_executed(self, executed: Action) -> Action:
        """Bound the next target against this one."""
        self._target = executed[JOINTS]
        self._is_limited = self._is_cut
        return executed

    def info(self) -> dict[str, NDArray[Any]]:
        """Return whether the last action was cut."""
        return {"is_limited": self._is_limited}
