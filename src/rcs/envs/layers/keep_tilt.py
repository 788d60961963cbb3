"""Actions of a tool that keeps its tilt: fewer numbers to learn where a tool points down."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs.envs.layers.layer import ActionSpaces, CopyIndex, Layer, everywhere, renew, replaced, require_xyzrpy
from rcs.envs.spaces import JOINTS, TQUAT, XYZRPY, XYZYAW, Action, Observation
from rcs.kinematics.chain import POSE
from rcs.spatial import compose, inverse, tquat_to_xyzrpy, xyzrpy_to_tquat

KEPT = [0, 1, 2, 5]
"""Indices of the components that are left of translation and roll, pitch, yaw."""


class KeepTilt(Layer):
    """Take `xyzyaw`, the change of translation and yaw, and pass on `xyzrpy` with which the tool keeps its tilt.

    Put it on `xyzrpy` relative to the last step. Whenever the last target is tilted otherwise than the tool was at the
    start of the episode, because the arm could not reach a pose, the tool turns back, as fast as relative control
    allows. The tool of an arm with five joints leans at most places, the start among them; it is kept as near to the
    vertical as the arm can.
    """

    memory = ("_start", "_last")

    def __init__(self) -> None:
        """Know no start yet."""
        self._start: NDArray[np.float64] | None = None
        self._last: NDArray[np.float64] | None = None
        self._bound = np.zeros(6)
        self._leans = False

    def action_spaces(self, inner: ActionSpaces) -> ActionSpaces:
        """Replace `xyzrpy` by `xyzyaw`.

        Raises:
            InvalidSetup: The level below takes no `xyzrpy` relative to the last step.
        """
        require_xyzrpy(self, inner)
        self._bound = box = inner[XYZRPY].high
        own = spaces.Box(-box[KEPT], box[KEPT], dtype=np.float64)
        return replaced(inner, XYZRPY, XYZYAW, own)

    def observation_spaces(self, inner: Mapping[str, spaces.Space[Any]]) -> dict[str, spaces.Space[Any]]:
        """Look how many joints the arm has; the observations are those of the level below."""
        shape = inner[JOINTS].shape
        assert shape is not None
        self._leans = shape[0] < POSE
        return dict(inner)

    def reset(self, observation: Observation, where: CopyIndex = everywhere) -> None:
        """Remember how the tool is tilted; with five joints, how it would be if it leaned to no side."""
        start = _upright(observation[TQUAT]) if self._leans else observation[TQUAT]
        self._start = renew(self._start, start, where)
        self._last = renew(self._last, observation[TQUAT], where)

    def rebase(self, observation: Observation) -> None:
        """Turn back from the measured pose."""
        self._last = observation[TQUAT].copy()

    def map_action(self, action: Action) -> Action:
        """Put in the roll and the pitch that take the last target back to the tilt of the start."""
        if self._start is None or self._last is None:
            raise RuntimeError("KeepTilt.map_action was called before reset")
        given = action[XYZYAW]
        full = np.zeros((*given.shape[:-1], 6))
        full[..., KEPT] = given
        full[..., 3:] = tquat_to_xyzrpy(compose(xyzrpy_to_tquat(full), _back(self._start, self._last)))[..., 3:]
        full = np.minimum(np.maximum(full, -self._bound), self._bound)
        return replaced(action, XYZYAW, XYZRPY, full)

    def map_executed(self, executed: Action) -> Action:
        """Go on from what was sent."""
        self._last = executed[TQUAT]
        return executed


def _upright(tool: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return poses (..., 7) turned in place by the least angle that brings their z axis to the vertical, up or down."""
    x, y, z, w = (tool[..., 3 + i] for i in range(4))
    axis_x, axis_y, axis_z = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
    side = np.where(axis_z < 0.0, -1.0, 1.0)
    # The turn from a unit vector a to b is the quaternion (a x b, 1 + a . b), normalised; b is the vertical.
    turn = np.zeros(tool.shape)
    turn[..., 3], turn[..., 4], turn[..., 6] = axis_y * side, -axis_x * side, 1.0 + axis_z * side
    turn[..., 3:] /= np.sqrt(np.vecdot(turn[..., 3:], turn[..., 3:]))[..., None]
    upright = compose(turn, tool)
    upright[..., :3] = tool[..., :3]
    return upright


def _back(start: NDArray[np.float64], last: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation without yaw that tilts a tool as at the start, as poses (..., 7) without a translation."""
    start, last = start.copy(), last.copy()
    start[..., :3] = last[..., :3] = 0.0
    turn = compose(last, inverse(start))
    # The yaw is the twist about the vertical: of the turn's quaternion, what is left without x and y.
    turn[..., 3:5] = 0.0
    z, w = turn[..., 5], turn[..., 6]
    length = np.sqrt(z * z + w * w)[..., None]
    turn[..., 5:] = np.where(length > 1e-6, turn[..., 5:] / np.maximum(length, 1e-6), (0.0, 1.0))
    return compose(compose(turn, start), inverse(last))
