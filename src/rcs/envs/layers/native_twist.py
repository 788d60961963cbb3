"""Actions that are velocities of the TCP, where the arm's controller moves it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rcs.envs.layers.layer import ActionSpaces, CopyIndex, Layer, everywhere, renew, replaced
from rcs.envs.spaces import TQUAT, TWIST, Action, Observation
from rcs.spatial import Pose, compose


class NativeTwist(Layer):
    """Pass `twist` actions on to the arm's controller, within their bounds.

    What is too fast is slowed down as a whole, so that the TCP keeps its direction; `info["is_limited"]` reports it.
    The target of an action is where its twist takes the TCP in one control period, from where it was measured.
    """

    memory = ("_measured", "_is_cut", "_is_limited")

    def __init__(self, frequency: float) -> None:
        """Set the control steps per second [Hz]."""
        self._period = 1.0 / frequency
        self._bound: NDArray[np.float64] = np.zeros(6)
        self._measured: NDArray[np.float64] | None = None
        self._is_cut: NDArray[np.bool_] = np.zeros((), np.bool_)  # by the last map_action
        self._is_limited: NDArray[np.bool_] = np.zeros((), np.bool_)

    def action_spaces(self, inner: ActionSpaces) -> ActionSpaces:
        """Return those of the level below, which has the bounds."""
        self._bound = inner[TWIST].high.astype(np.float64)
        return inner

    def reset(self, observation: Observation, where: CopyIndex = everywhere) -> None:
        """Start from the measured pose."""
        is_first = self._measured is None
        self._measured = measured = observation[TQUAT].copy()
        self._is_limited = renew(None if is_first else self._is_limited, np.zeros(measured.shape[:-1], np.bool_), where)

    def rebase(self, observation: Observation) -> None:
        """Go on from the measured pose."""
        self._measured = observation[TQUAT].copy()

    def map_observation(self, observation: Observation) -> Observation:
        """Remember the measured pose."""
        self._measured = observation[TQUAT].copy()
        return observation

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
        turn = np.zeros_like(self._measured)
        turn.reshape(-1, 7)[:, 3:] = [
            Pose.from_rotvec(np.zeros(3), row).quaternion for row in way.reshape(-1, 6)[:, 3:]
        ]
        turned = np.zeros_like(self._measured)
        turned[..., 3:] = self._measured[..., 3:]
        target = compose(turn, turned)
        target[..., :3] = self._measured[..., :3] + way[..., :3]
        return replaced(executed, TWIST, TQUAT, target)

    def info(self) -> dict[str, NDArray[Any]]:
        """Return whether the last action was slowed down."""
        return {"is_limited": self._is_limited}

    def __str__(self) -> str:
        """Return the layer for the printed stack."""
        return "NativeTwist(twist for the arm's controller)"
