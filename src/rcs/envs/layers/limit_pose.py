"""Bounds how far a target of the TCP may run ahead, where the arm's controller leads it there."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.layers.layer import CopyIndex, Layer, everywhere, renew
from rcs.envs.spaces import TQUAT, Action, Observation, require_direction
from rcs.spatial import distance, limit_step, normalize

LEAD = 0.5
"""Time by which a target may be ahead of the measured TCP [s]: at 1.2 m/s², a TCP brakes from 0.6 m/s."""

ROUNDING = 1e-9
"""A target that is moved by less than this [m, rad] counts as unlimited."""


class LimitPose(Layer):
    """Bound every `tquat` target against the last target and against the measured pose.

    The first bound is a speed times the control period; a target farther away is approached straight, step by step. The
    second keeps the target from running away while the arm is blocked. A target within a step of where the TCP is
    measured is not bounded: an arm that is to stop brakes at once. `info["is_limited"]` reports cuts.
    """

    memory = ("_target", "_measured", "_is_cut", "_is_limited")

    def __init__(self, translation_speed: float, rotation_speed: float, *, frequency: float) -> None:
        """Set the bounds.

        Args:
            translation_speed: Largest speed of the target's translation [m/s].
            rotation_speed: Largest speed of its rotation [rad/s].
            frequency: Control steps per second [Hz].
        """
        speeds = np.array([translation_speed, rotation_speed])
        self._step = speeds / frequency
        self._lead = speeds * (LEAD + 1.0 / frequency)
        self._target: NDArray[np.float64] | None = None
        self._measured: NDArray[np.float64] | None = None
        self._is_cut: NDArray[np.bool_] = np.zeros((), np.bool_)  # by the last map_action
        self._is_limited: NDArray[np.bool_] = np.zeros((), np.bool_)

    def reset(self, observation: Observation, where: CopyIndex = everywhere) -> None:
        """Start from the measured pose."""
        self._measured = measured = observation[TQUAT].copy()
        never = np.zeros(measured.shape[:-1], np.bool_)
        self._is_limited = renew(None if self._target is None else self._is_limited, never, where)
        self._target = renew(self._target, measured, where)

    def rebase(self, observation: Observation) -> None:
        """Bound the next target against the measured pose alone."""
        self._measured = self._target = observation[TQUAT].copy()

    def map_observation(self, observation: Observation) -> Observation:
        """Remember the measured pose."""
        self._measured = observation[TQUAT].copy()
        return observation

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

    def map_executed(self, executed: Action) -> Action:
        """Bound the next target against this one."""
        self._target = executed[TQUAT]
        self._is_limited = self._is_cut
        return executed

    def info(self) -> dict[str, NDArray[Any]]:
        """Return whether the last action was cut."""
        return {"is_limited": self._is_limited}

    def __str__(self) -> str:
        """Return the layer for the printed stack."""
        return "LimitPose(tquat for the arm's controller)"
