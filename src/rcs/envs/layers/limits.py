"""Bounds of how far the target of an arm may run ahead, whatever its source: joints, poses and twists."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs._core import limit_rows
from rcs.envs.layers.layer import ActionSpaces, CopyIndex, Layer, everywhere, renew, replaced
from rcs.envs.layers.relative import shift
from rcs.envs.spaces import JOINTS, TQUAT, TWIST, Action, Observation, require_direction
from rcs.spatial import Pose, distance, limit_step, normalize

ROUNDING = 1e-9
"""A target that is moved by less than this [rad, m] counts as unlimited."""

FOUND_OUTSIDE = 0.02
"""A joint farther outside its range than this [rad] was found there; others were carried there by their servos."""

LEAD = 0.5
"""Time by which a target may be ahead of the measured TCP [s]: at 1.2 m/s², a TCP brakes from 0.6 m/s."""


class Limit(Layer):
    """Remember the last target and what is measured, to bound the next target against both.

    `info["is_limited"]` reports cuts.
    """

    memory = ("_target", "_measured", "_is_cut", "_is_limited")
    key = JOINTS
    """Key of the quantity that is measured and bounded."""

    def __init__(self) -> None:
        """Know no place yet."""
        self._target: NDArray[np.float64] | None = None
        self._measured: NDArray[np.float64] | None = None
        self._is_cut: NDArray[np.bool_] = np.zeros((), np.bool_)  # by the last map_action
        self._is_limited: NDArray[np.bool_] = np.zeros((), np.bool_)

    def reset(self, observation: Observation, where: CopyIndex = everywhere) -> None:
        """Start from what is measured."""
        self._measured = measured = observation[self.key].copy()
        never = np.zeros(measured.shape[:-1], np.bool_)
        self._is_limited = renew(None if self._target is None else self._is_limited, never, where)
        self._target = renew(self._target, measured, where)

    def rebase(self, observation: Observation) -> None:
        """Bound the next target against what is measured alone."""
        self._measured = self._target = observation[self.key].copy()

    def map_observation(self, observation: Observation) -> Observation:
        """Remember what is measured; the observation belongs to the caller."""
        self._measured = observation[self.key].copy()
        return observation

    def map_executed(self, executed: Action) -> Action:
        """Bound the next target against this one."""
        self._target = executed[self.key]
        self._is_limited = self._is_cut
        return executed

    def info(self) -> dict[str, NDArray[Any]]:
        """Return whether the last action was cut."""
        return {"is_limited": self._is_limited}


class LimitStep(Limit):
    """Bound every joint target against the last target and against the measured joints.

    The first bound is the joint velocity limit times the control period. The second keeps the target from running away
    while the arm is blocked. To a target farther away all joints go the same share of the way, so that the TCP keeps
    its direction; a joint that is blocked at the end of its lead stops them all. A step that brings a target back
    towards the measured joint is not bounded: an arm that is to turn round brakes at once. `info["is_limited"]` reports
    cuts.
    """

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
        super().__init__()
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


class LimitPose(Limit):
    """Bound every `tquat` target against the last target and against the measured pose.

    The first bound is a speed times the control period; a target farther away is approached straight, step by step. The
    second keeps the target from running away while the arm is blocked. A target within a step of where the TCP is
    measured is not bounded: an arm that is to stop brakes at once. `info["is_limited"]` reports cuts.
    """

    key = TQUAT

    def __init__(self, translation_speed: float, rotation_speed: float, *, frequency: float) -> None:
        """Set the bounds.

        Args:
            translation_speed: Largest speed of the target's translation [m/s].
            rotation_speed: Largest speed of its rotation [rad/s].
            frequency: Control steps per second [Hz].
        """
        super().__init__()
        speeds = np.array([translation_speed, rotation_speed])
        self._step = speeds / frequency
        self._lead = speeds * (LEAD + 1.0 / frequency)

    def map_action(self, action: Action) -> Action:
        """Cut the target.

        Raises:
            InvalidAction: A quaternion has no direction.
        """
        if self._target is None or self._measured is None:
            raise RuntimeError("LimitPose.map_action was called before reset")
        require_direction(action[TQUAT])
        asked = normalize(action[TQUAT])
        is_near = (distance(self._measured, asked) <= self._step).all(axis=-1, keepdims=True)
        reached = limit_step(self._measured, limit_step(self._target, asked, *self._step), *self._lead)
        target = np.where(is_near, asked, reached)
        self._is_cut = np.asarray((distance(target, asked) > ROUNDING).any(axis=-1))
        return {**action, TQUAT: target}

    def __str__(self) -> str:
        """Return the layer for the printed stack."""
        return "LimitPose(tquat for the arm's controller)"


class NativeTwist(Limit):
    """Pass `twist` actions on to the arm's controller, within their bounds.

    A twist that is too fast is slowed down as a whole, so that the TCP keeps its direction; `info["is_limited"]`
    reports it. The target of an action is where its twist takes the TCP in one control period, from where it was
    measured.
    """

    key = TQUAT

    def __init__(self, frequency: float) -> None:
        """Set the control steps per second [Hz]."""
        super().__init__()
        self._period = 1.0 / frequency
        self._bound: NDArray[np.float64] = np.zeros(6)

    def action_spaces(self, inner: ActionSpaces) -> ActionSpaces:
        """Return those of the level below, which has the bounds."""
        self._bound = inner[TWIST].high.astype(np.float64)
        return inner

    def map_action(self, action: Action) -> Action:
        """Slow down what is too fast."""
        asked = action[TWIST]
        excess = np.maximum((np.abs(asked) / self._bound).max(axis=-1), 1.0)
        self._is_cut = excess > 1.0
        return {**action, TWIST: asked / excess[..., None]}

    def map_executed(self, executed: Action) -> Action:
        """Return where the twist takes the TCP, in its place."""
        if self._measured is None:
            raise RuntimeError("NativeTwist.map_executed was called before reset")
        self._is_limited = self._is_cut
        way = self._period * executed[TWIST]
        step = np.concatenate([way[..., :3], np.zeros((*way.shape[:-1], 4))], axis=-1)
        step.reshape(-1, 7)[:, 3:] = [
            Pose.from_rotvec(np.zeros(3), row).quaternion for row in way.reshape(-1, 6)[:, 3:]
        ]
        return replaced(executed, TWIST, TQUAT, shift(self._measured, step))

    def __str__(self) -> str:
        """Return the layer for the printed stack."""
        return "NativeTwist(twist for the arm's controller)"
