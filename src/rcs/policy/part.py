"""One part of an action: how rows of a chunk become motions, and how motions are cut, joined and averaged in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rcs.agents.action_writer import difference
from rcs.envs.layers.relative import shift
from rcs.spatial import interpolate, normalize, tquat_to_xyzrpy, xyzrpy_to_tquat

Kind = Literal["linear", "pose", "rpy", "opening", "velocity"]
"""Numbers that add up; poses as translation and quaternion, or as roll, pitch, yaw; a gripper's opening, which is not
interpolated in time; velocities."""

Array = NDArray[np.float64]
STILL = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
"""The pose difference of no motion."""


@dataclass(frozen=True)
class Part:
    """A part of an action, such as `joints` or `left/gripper`. Inside, poses are (7,): translation [m], xyzw."""

    name: str
    columns: slice
    """Its columns of a chunk."""
    kind: Kind
    is_difference: bool = False
    """Whether a row is a motion of one period, and no target."""
    counts_from_start: bool = False
    """Whether a row counts from the state in which the chunk was asked for."""
    scale: float = 1.0
    """Takes a number in the policy's unit to ours."""
    offset: float = 0.0
    """Is added after scaling; differences have none."""

    @property
    def is_pose(self) -> bool:
        """Whether values are poses."""
        return self.kind in ("pose", "rpy")

    def read(self, actions: Array, start: Array | None) -> Array:
        """Return the rows of a chunk in our units, (horizon, n): targets, or motions of one period.

        Args:
            actions: The chunk, (horizon, size).
            start: State in which it was asked for, (n,); needed by rows that count from there.
        """
        rows = self.scale * actions[:, self.columns] + (0.0 if self.is_difference else self.offset)
        if self.is_pose:
            rows = normalize(xyzrpy_to_tquat(rows) if self.kind == "rpy" else rows)
        if self.counts_from_start:
            assert start is not None, "the agent gives the state of every part that counts from it"
            rows = shift(np.broadcast_to(start, rows.shape), rows) if self.is_pose else start + rows
        return rows

    def write(self, value: Array) -> Array:
        """Return a value in the form of the environment's action."""
        return tquat_to_xyzrpy(value) if self.kind == "rpy" else value

    def unread(self, value: Array, start: Array | None) -> Array:
        """Return a value as a row of a chunk has it, that was asked for in a state: the inverse of `read`."""
        if self.counts_from_start:
            assert start is not None, "the agent gives the state of every part that counts from it"
            value = difference(start, value) if self.is_pose else value - start
        return (self.write(value) - (0.0 if self.is_difference else self.offset)) / self.scale

    def between(self, a: Array, b: Array, fraction: float) -> Array:
        """Return what lies between two targets, or between two motions of the same time."""
        return interpolate(a, b, fraction) if self.is_pose else a + fraction * (b - a)

    def share(self, motion: Array, fraction: float) -> Array:
        """Return a share of a motion."""
        return interpolate(STILL, motion, fraction) if self.is_pose else fraction * motion

    def joined(self, motions: Sequence[Array]) -> Array:
        """Return the motion that several make, one after the other."""
        total = motions[0]
        for motion in motions[1:]:
            total = shift(total, motion) if self.is_pose else total + motion
        return total

    def mean(self, values: Sequence[Array], weights: Sequence[float]) -> Array:
        """Return the weighted mean; of rotations, the normalised sum of the quaternions on one side.

        Args:
            values: One or more, (n,) each.
            weights: As many; their sum is 1.
        """
        if len(values) == 1:
            return values[0]
        stacked = np.array(values)
        if self.is_pose:
            stacked[:, 3:] *= np.where(stacked[:, 3:] @ stacked[0, 3:] < 0, -1.0, 1.0)[:, None]
        total = np.asarray(weights) @ stacked
        return normalize(total) if self.is_pose else total
