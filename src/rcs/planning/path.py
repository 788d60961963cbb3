"""Paths of joints: straight lines between waypoints, and with times, which round off the corners."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs._core import LineProfile
from rcs.errors import InvalidSetup

Rows = NDArray[np.float64]

MINIMUM_JERK_PEAK = 15 / 8
"""Largest speed of `minimum_jerk` over its mean speed."""


@dataclass(frozen=True, eq=False)
class Path:
    """Joint positions one after the other, without times."""

    waypoints: NDArray[np.float64]
    """Joint positions [rad], (n, dof), n at least 2. The first is the start, the last the goal."""

    def __post_init__(self) -> None:
        """Take a read-only copy.

        Raises:
            InvalidSetup: There are not at least two rows of finite numbers.
        """
        rows = np.array(self.waypoints, np.float64)
        if rows.ndim != 2 or len(rows) < 2 or not np.isfinite(rows).all():
            raise InvalidSetup(
                f"The waypoints of a path have the shape {rows.shape}; valid is (n, dof), n at least 2, finite."
            )
        rows.flags.writeable = False
        object.__setattr__(self, "waypoints", rows)

    @property
    def length(self) -> float:
        """Length in joint space [rad]."""
        return float(np.linalg.norm(np.diff(self.waypoints, axis=0), axis=1).sum())

    def at(self, shares: ArrayLike) -> NDArray[np.float64]:
        """Return the joints [rad] at shares of the length, 0 … 1, (..., dof)."""
        from rcs_data.diversity import at_shares  # on use: it imports pyarrow

        return at_shares(self.waypoints, shares)


def diversity(paths: Sequence[Path | NDArray[np.float64]]) -> float:
    """Return how much paths differ: the mean over all pairs of the RMS distance at equal shares of the length [rad].

    Each path is compared relative to its own start and goal, so that different goals do not count as different paths.
    Straight motions give 0.

    Args:
        paths: Paths, or joints row by row, (n, dof); at least two.

    Raises:
        InvalidSetup: There are fewer than two.
    """
    if len(paths) < 2:
        raise InvalidSetup(f"{len(paths)} path was given; to compare takes at least 2.")
    from rcs_data.diversity import diversity_of_ways  # on use: it imports pyarrow

    return diversity_of_ways([(path if isinstance(path, Path) else Path(path)).waypoints for path in paths])


@dataclass(frozen=True, eq=False)
class Samples:
    """A timed path at some times; all but the times are (n, dof)."""

    times: Rows
    """s, (n,)"""
    positions: Rows
    """rad"""
    velocities: Rows
    """rad/s"""
    accelerations: Rows
    """rad/s^2"""
    jerks: Rows
    """rad/s^3"""


@dataclass(frozen=True, eq=False)
class Line:
    """A straight line in joint space."""

    start: Rows
    direction: Rows
    """Direction of length 1 [rad]."""
    profile: LineProfile
    """Distance along it [rad] over time."""

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.profile.duration

    def at(self, times: Rows) -> tuple[Rows, Rows, Rows, Rows]:
        """Return positions, velocities, accelerations and jerks at times from its start, (n, dof) each."""
        motion = self.profile.at(times)
        way, *rates = (motion[:, k : k + 1] * self.direction for k in range(4))
        return (self.start + way, *rates)  # pyright: ignore[reportReturnType]  four of them


@dataclass(frozen=True, eq=False)
class Bend:
    """From one straight line to the next at constant speed, along a quartic curve without a jump of acceleration.

    The direction turns from the one to the other as w = 3s² - 2s³ of the share s of the bend, so acceleration is 0 at
    both ends, no joint is faster than on the faster of both lines, and the curve lies in the triangle of its ends and
    the corner.
    """

    start: Rows
    before: Rows
    """Direction of the line before, of length 1."""
    after: Rows
    length: float
    """Length, half of it on either line [rad]."""
    speed: float
    """rad/s"""

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.length / self.speed

    def along(self, shares: Rows) -> Rows:
        """Return the positions at shares of the bend, 0 … 1, (n, dof)."""
        s = shares[:, None]
        turned = s**3 - 0.5 * s**4  # the integral of w
        return self.start + self.length * (s * self.before + turned * (self.after - self.before))

    def at(self, times: Rows) -> tuple[Rows, Rows, Rows, Rows]:
        """Return positions, velocities, accelerations and jerks at times from its start, (n, dof) each."""
        s = (times / self.duration)[:, None]
        turn, rate = self.after - self.before, self.speed / self.length
        return (
            self.along(s[:, 0]),
            self.speed * (self.before + (3 * s**2 - 2 * s**3) * turn),
            self.speed * rate * (6 * s - 6 * s**2) * turn,
            self.speed * rate**2 * (6 - 12 * s) * turn,
        )


@dataclass(frozen=True, eq=False)
class TimedPath:
    """Joint positions over time, from rest to rest."""

    pieces: tuple[Line | Bend, ...]
    """Lines and bends in turn."""

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return sum(piece.duration for piece in self.pieces)

    def at(self, times: ArrayLike) -> Samples:
        """Return the motion at times from the start [s], (n,); before and after, the joints stand still."""
        wanted = np.atleast_1d(np.asarray(times, np.float64))
        ends = np.cumsum([piece.duration for piece in self.pieces])
        piece_of = np.minimum(np.searchsorted(ends, wanted, side="right"), len(self.pieces) - 1)
        rows = np.zeros((4, len(wanted), len(self.pieces[0].start)))
        for i in np.unique(piece_of):
            where = piece_of == i
            rows[:, where] = self.pieces[i].at(wanted[where] - (ends[i - 1] if i else 0.0))
        is_still = (wanted < 0.0) | (wanted > ends[-1])
        rows[1:, is_still] = 0.0
        return Samples(wanted, *rows)

    def sampled(self, rate: float) -> Samples:
        """Return the motion at a rate [Hz], from the start to the end, which is the last sample.

        Raises:
            InvalidSetup: The rate is not positive.
        """
        if not rate > 0.0:
            raise InvalidSetup(f"rate is {rate!r}; valid is a number above 0.")
        times = np.arange(0.0, self.duration, 1.0 / rate)
        return self.at(np.append(times, self.duration))


def minimum_jerk(fraction: ArrayLike) -> Rows:
    """Return the share of a path that is done after a fraction of its time, with the least jerk from rest to rest.

    It minimises the integral of the squared jerk, as human arms do. Flash and Hogan, "The coordination of arm
    movements", 1985. Its largest speed is 15/8 of the mean speed, its largest acceleration 10/√3 of length over time
    squared.

    Args:
        fraction: Fractions of the time, any shape; those below 0 and above 1 count as 0 and 1.
    """
    x = np.clip(np.asarray(fraction, np.float64), 0.0, 1.0)
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))
