"""Paths of joints, and their times: as fast as limits of velocity, acceleration and jerk allow.

Corners are rounded off where there is room, and passed at a constant speed; where a rounded corner would touch
something, the path stops there. Between two corners the speed changes along a jerk-limited profile (Ruckig).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs._core import LineProfile
from rcs.errors import InvalidSetup
from rcs.robots.description import ArmDescription

Rows = NDArray[np.float64]

COMPARED = 64
"""Points at which `diversity` compares two paths."""


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
        way = np.concatenate([[0.0], np.linalg.norm(np.diff(self.waypoints, axis=0), axis=1).cumsum()])
        wanted = np.asarray(shares, np.float64) * way[-1]
        return np.stack([np.interp(wanted, way, column) for column in self.waypoints.T], axis=-1)


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
    shares = np.linspace(0.0, 1.0, COMPARED)
    bent: list[Rows] = []
    for path in paths:
        points = (path if isinstance(path, Path) else Path(path)).at(shares)
        bent.append(points - (points[0] + shares[:, None] * (points[-1] - points[0])))
    apart = [float(np.sqrt(((a - b) ** 2).sum(-1).mean())) for i, a in enumerate(bent) for b in bent[:i]]
    return float(np.mean(apart))


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


MARGIN = 1e-3
"""Share by which a motion stays below its limits, as libfranka does (rate_limiting.h, kLimitEps)."""
CHECKED = 16
"""Lines that a bend is checked as; the curve is up to 1/1000 of its length away from them."""
SHORTEST = 1e-3
"""Bends shorter than this are not worth it; the path stops at their corner [rad]."""
SAME = 1e-9
"""Waypoints nearer to each other than this are one [rad]."""

IsFree = Callable[[NDArray[np.float64]], bool]
"""Returns whether joints (n, dof), connected by straight lines, touch nothing."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointLimits:
    """Limits of a timed path, one number per joint, (dof,)."""

    velocity: NDArray[np.float64]
    """rad/s"""
    acceleration: NDArray[np.float64]
    """rad/s^2"""
    jerk: NDArray[np.float64]
    """rad/s^3"""

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InvalidSetup: They are not as many positive numbers each.
        """
        for name in ("velocity", "acceleration", "jerk"):
            values = np.array(getattr(self, name), np.float64)
            if values.shape != np.shape(self.velocity) or values.ndim != 1 or not (values > 0.0).all():
                raise InvalidSetup(f"The limits of {name} are {values}; valid is a number above 0 for each joint.")
            object.__setattr__(self, name, values)

    @classmethod
    def of(cls, *arms: ArmDescription, scale: float = 1.0) -> JointLimits:
        """Return the limits of arms, one after the other.

        Args:
            arms: The arms, in the order of the joints.
            scale: Share of their speed, above 0 and up to 1: the same way then takes 1 / scale times as long.

        Raises:
            InvalidSetup: The scale is not valid.
        """
        if not 0.0 < scale <= 1.0:
            raise InvalidSetup(f"scale is {scale!r}; valid is above 0 and up to 1.")
        rows = [np.concatenate([getattr(arm, f"{name}_limit") for arm in arms]) for name in _NAMES]
        return cls(**{name: row * scale ** (i + 1) for i, (name, row) in enumerate(zip(_NAMES, rows, strict=True))})


_NAMES = ("velocity", "acceleration", "jerk")


def time_path(path: Path, limits: JointLimits, *, bend: float = 0.5, is_free: IsFree | None = None) -> TimedPath:
    """Give a path times.

    Args:
        path: The path.
        limits: Limits of the joints, which hold at every moment.
        bend: How long a bend may be [rad], half of it on each side of its corner; 0 stops at every corner. Where
            shorter bends, or stops, are faster, all are: a sharp turn may take longer than a stop.
        is_free: Says whether a bend touches nothing, given joints along it that straight lines connect; None believes
            it. A bend that does is halved until it does not, and left out below 1 mrad.

    Raises:
        InvalidSetup: The path has another number of joints than the limits, or `bend` is below 0.
    """
    if path.waypoints.shape[1] != len(limits.velocity):
        raise InvalidSetup(f"The path has {path.waypoints.shape[1]} joints, the limits {len(limits.velocity)}.")
    if not bend >= 0.0:
        raise InvalidSetup(f"bend is {bend!r}; valid is a number of at least 0.")
    points = path.waypoints
    points = points[np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > SAME)]
    if len(points) == 1:
        standing = np.zeros(points.shape[1])
        return TimedPath((Line(points[0], standing, LineProfile(0.0, 0.0, 0.0, 1.0, 1.0, 1.0)),))
    longest = (bend, bend / 3, 0.0) if bend > 0.0 else (0.0,)
    return min((_timed(points, limits, length, is_free) for length in longest), key=lambda made: made.duration)


def _timed(points: NDArray[np.float64], limits: JointLimits, bend: float, is_free: IsFree | None) -> TimedPath:
    """Return the motion along points, all different, with bends of up to a length."""
    ways = np.diff(points, axis=0)
    lengths = np.linalg.norm(ways, axis=1)
    directions = ways / lengths[:, None]
    bends = [
        _bend(points[i + 1], directions[i : i + 2], min(bend, *lengths[i : i + 2]), limits, is_free)
        for i in range(len(lengths) - 1)
    ]
    # The fastest that lines allow, and at their ends the speed of the bends, or 0.
    rates = [_along(direction, limits) for direction in directions]
    cut = np.array([0.0, *(0.0 if b is None else b.length / 2 for b in bends), 0.0])
    left = np.maximum(lengths - cut[:-1] - cut[1:], 0.0)
    speeds = [
        0.0,
        *(0.0 if b is None else min(b.speed, rates[i][0], rates[i + 1][0]) for i, b in enumerate(bends)),
        0.0,
    ]
    for i in range(len(left)):  # what can be reached from before, then what can be braked from
        speeds[i + 1] = min(speeds[i + 1], LineProfile.fastest(speeds[i], left[i], *rates[i]))
    for i in reversed(range(len(left))):
        speeds[i] = min(speeds[i], LineProfile.fastest(speeds[i + 1], left[i], *rates[i]))
    pieces: list[Line | Bend] = []
    for i, direction in enumerate(directions):
        profile = LineProfile(left[i], speeds[i], speeds[i + 1], *rates[i])
        pieces.append(Line(points[i] + cut[i] * direction, direction, profile))
        if i < len(bends) and (made := bends[i]) is not None:
            pieces.append(replace(made, speed=speeds[i + 1]))
    return TimedPath(tuple(pieces))


def _along(direction: NDArray[np.float64], limits: JointLimits) -> tuple[float, float, float]:
    """Return the largest velocity, acceleration and jerk along a line."""
    share = np.maximum(np.abs(direction), 1e-12)
    return tuple((1.0 - MARGIN) * float((getattr(limits, name) / share).min()) for name in _NAMES)  # pyright: ignore[reportReturnType]


def _bend(
    corner: NDArray[np.float64],
    directions: NDArray[np.float64],
    length: float,
    limits: JointLimits,
    is_free: IsFree | None,
) -> Bend | None:
    """Return the longest bend around a corner that is free, None if the path has to stop there."""
    before, after = directions
    while length > SHORTEST:
        speed = _speed(before, after, length, limits)
        bend = Bend(corner - 0.5 * length * before, before, after, length, speed)
        if is_free is None or is_free(bend.along(np.linspace(0.0, 1.0, CHECKED + 1))):
            return bend
        length *= 0.5
    return None


def _speed(before: NDArray[np.float64], after: NDArray[np.float64], length: float, limits: JointLimits) -> float:
    """Return the constant speed at which a bend keeps the limits: w' is up to 1.5 and w'' up to 6 per share."""
    turn = np.maximum(np.abs(after - before), 1e-12)
    share = np.maximum(np.maximum(np.abs(before), np.abs(after)), 1e-12)
    fastest = [
        limits.velocity / share,
        np.sqrt(limits.acceleration * length / (1.5 * turn)),
        np.cbrt(limits.jerk * length**2 / (6.0 * turn)),
    ]
    return (1.0 - MARGIN) * float(np.min(fastest))
