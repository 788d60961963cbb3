"""Commands at any time, from one chunk of a policy, from those of which one takes over from another, or from many.

A step of the loop from `time` on, `period` long, asks for the command of that step. A row of a chunk is where to be at
the *end* of its time, so a step gets the value of the curve through the rows at the step's end; where loop and policy
have the same rate that is the row itself. Between rows, targets are interpolated and motions are split.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rcs.envs.layers.relative import shift
from rcs.errors import InvalidSetup
from rcs.spatial import interpolate, normalize, tquat_to_xyzrpy, xyzrpy_to_tquat

Kind = Literal["linear", "pose", "rpy", "opening", "velocity"]
"""Numbers that add up; poses as translation and quaternion, or as roll, pitch, yaw; a gripper's opening, which is not
interpolated in time; velocities."""

Array = NDArray[np.float64]
STILL = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
"""The pose difference of no motion."""

Command = Mapping[str, Array]
"""Command for one step, by part: targets, or the motion of the step."""

NEAR = 1e-6
"""Share of a row that is rounding."""


@dataclass(frozen=True)
class Part:
    """A part of an action, such as `joints` or `left/gripper`. Inside, poses are (7,): translation [m], xyzw."""

    name: str
    columns: slice
    """Its columns of a chunk."""
    kind: Kind
    is_difference: bool = False
    """True if a row is a motion of one period instead of a target."""
    counts_from_start: bool = False
    """True if a row counts from the state of the observation that the chunk answers."""
    scale: float = 1.0
    """Takes a number in the policy's unit to ours."""
    offset: float = 0.0
    """Is added after scaling; differences have none."""

    @property
    def is_pose(self) -> bool:
        """True if values are poses."""
        return self.kind in ("pose", "rpy")

    def read(self, actions: Array, start: Array | None) -> Array:
        """Return the rows of a chunk in our units, (horizon, n): targets, or motions of one period.

        Args:
            actions: The chunk, (horizon, size).
            start: State of the observation that it answers, (n,); needed by rows that count from there.
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

    def between(self, a: Array, b: Array, fraction: float) -> Array:
        """Return the interpolation of two targets, or of two motions of the same time."""
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


class ChunkPlan:
    """The rows of one chunk."""

    def __init__(
        self,
        parts: Sequence[Part],
        actions: Array,
        *,
        time: float,
        period: float,
        start: Mapping[str, Array] | None = None,
    ) -> None:
        """Take a chunk.

        Args:
            parts: The parts of an action.
            actions: (horizon, size).
            time: Time of the observation that it answers [s].
            period: Duration of each row [s].
            start: Targets or state at that time by part, from where the first row is reached; without one, the first
                row is commanded at once.

        Raises:
            InvalidSetup: A row is not finite, or the period is not positive.
        """
        if not np.isfinite(actions).all() or not (math.isfinite(period) and period > 0):
            raise InvalidSetup("A chunk has values that are not finite, or a period that is not above 0 s.")
        self.parts = list(parts)
        self.begin, self.period = time, period
        """Time of the observation that it answers, and duration of each row [s]."""
        self._count = len(actions)
        self.end = time + self._count * period
        """End of the last row [s]."""
        self.since = self.until = -math.inf
        """From when and until when it takes over from the plan before [s]; see `blended`."""
        self._start = dict(start or {})
        self._rows = {part.name: part.read(actions, self._start.get(part.name)) for part in self.parts}

    def row(self, time: float) -> int:
        """Return the number of the row that a time belongs to."""
        return math.floor((time - self.begin) / self.period + NEAR)

    def covers(self, time: float, period: float) -> bool:
        """Return whether it covers a whole step and does not end within it."""
        return self.end > time + period - NEAR * period

    def weight_before(self, time: float) -> float:
        """Return the weight of the plan before it at a time: the soft mask of real-time chunking."""
        if time >= self.until:
            return 0.0
        c = min((self.until - time) / (self.until - self.since), 1.0)
        return c * math.expm1(c) / math.expm1(1.0)

    def at(self, time: float, period: float) -> Command | None:
        """Return the command for a step; None before the chunk and past its end.

        Args:
            time: When the step begins [s].
            period: How long it lasts [s].
        """
        first = (time - self.begin) / self.period
        if not -NEAR <= first < self._count - NEAR:
            return None
        last = min((time + period - self.begin) / self.period, self._count)
        return {part.name: self._value(part, max(first, 0.0), last) for part in self.parts}

    def _value(self, part: Part, first: float, last: float) -> Array:
        rows = self._rows[part.name]
        if part.kind == "opening":
            row = math.floor((first + last) / 2 + NEAR)  # where most of the step is, whatever clocks jitter
            return rows[min(row, self._count - 1)]
        if part.is_difference or part.kind == "velocity":
            return self._motion(part, rows, first, last)
        index = math.ceil(last - NEAR) - 1
        fraction = last - index
        before = rows[index - 1] if index > 0 else self._start.get(part.name)
        if before is None or fraction > 1 - NEAR:
            return rows[index]
        return part.between(before, rows[index], fraction)

    def _motion(self, part: Part, rows: Array, first: float, last: float) -> Array:
        """Return the shares of all rows that a step overlaps; of velocities, their mean over the step."""
        shares: list[tuple[int, float]] = []
        for index in range(math.floor(first + NEAR), math.ceil(last - NEAR)):
            share = min(last, index + 1) - max(first, index)
            shares.append((index, 1.0 if abs(share - 1) < NEAR else share))
        if part.kind == "velocity":
            total = sum(share for _, share in shares)
            return part.mean([rows[index] for index, _ in shares], [share / total for _, share in shares])
        return part.joined([rows[index] if share == 1.0 else part.share(rows[index], share) for index, share in shares])


def blended(plans: Sequence[ChunkPlan], time: float, period: float) -> Command | None:
    """Return the command for a step while each plan takes over from the one before; None if there is none.

    At first all is as before, at the end all is new. The weight of the old plan is the soft mask of real-time chunking
    (Black, Galliker, Levine 2025, arXiv:2506.07339), w = c·(exp(c) - 1)/(e - 1) with c from 1 to 0. So what changes
    from a step to the next is at most the larger change of the two plans and (2e - 1)/(e - 1) · period/(until - since)
    of how far they are apart: there is no jump.

    Args:
        plans: From the oldest to the newest, one or more.
        time: When the step begins [s].
        period: How long it lasts [s].
    """
    command = plans[0].at(time, period)
    for before, plan in itertools.pairwise(plans):
        weight, new = plan.weight_before(time), plan.at(time, period)
        old = command if weight > 0 and before.covers(time, period) else None
        if old is None or new is None:
            command = old if new is None else new
        elif weight < 1:
            command = _mean(plan.parts, [old, new], [weight, 1 - weight])
        else:
            command = old
    return command


def averaged(
    plans: Sequence[ChunkPlan], time: float, period: float, *, decay: float, valid_for: float = math.inf
) -> Command | None:
    """Return the mean of all chunks that cover a step, aligned by time; None if there is none.

    Weights are those of ACT (Zhao et al. 2023, arXiv:2304.13705): exp(-m·i) for the i-th oldest, divided by their sum.

    Args:
        plans: From the oldest to the newest, one or more.
        time: When the step begins [s].
        period: How long it lasts [s].
        decay: ACT's m.
        valid_for: Age of its observation beyond which a plan is left out [s].
    """
    valid = [plan for plan in plans if time - plan.begin <= valid_for + NEAR * period]
    whole = [plan for plan in valid if plan.covers(time, period)]
    found = [command for plan in whole or valid if (command := plan.at(time, period)) is not None]
    if not found:
        return None
    weights = np.exp(-decay * np.arange(len(found)))
    return _mean(plans[-1].parts, found, (weights / weights.sum()).tolist())


def _mean(parts: Sequence[Part], commands: Sequence[Command], weights: Sequence[float]) -> Command:
    return {part.name: part.mean([command[part.name] for command in commands], weights) for part in parts}
