"""Ways from one place to another in a given time: straight lines of the TCP, quintic polynomials, least jerk.

Arrays are indexed from the right: values have the shape (..., n), times and durations (...). Many times on one way, and
many ways at one time each, are the same code. Before its start a way is at its start, and after its end at its end.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs.errors import InvalidSetup
from rcs.spatial import compose, interpolate, inverse, normalize

Law = Literal["linear", "minimum_jerk"]
"""How a share of the way grows with time: at constant speed, which starts and ends abruptly, or with the least jerk."""

PEAK_SPEED = {"linear": 1.0, "minimum_jerk": 15 / 8}
"""Largest speed over mean speed."""

Numbers = NDArray[np.float64]


def minimum_jerk(fraction: ArrayLike) -> Numbers:
    """Return the share of a way that is done after a fraction of its time, with the least jerk from rest to rest.

    Of all such motions it has the least integral of the squared jerk; people move their hands so. Flash and Hogan, "The
    coordination of arm movements", 1985. Its largest speed is 15/8 of the mean speed, its largest acceleration 10/√3 of
    way over time squared.

    Args:
        fraction: Fractions of the time, any shape; those below 0 and above 1 count as 0 and 1.
    """
    x = np.clip(np.asarray(fraction, np.float64), 0.0, 1.0)
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


def _minimum_jerk_rate(fraction: Numbers) -> Numbers:
    """Return the derivative of `minimum_jerk`; 0 outside of 0 … 1."""
    x = np.clip(fraction, 0.0, 1.0)
    return 30.0 * x * x * (1.0 - x) * (1.0 - x)


class Quintic:
    """The polynomial of degree five from one state to another: position, velocity and acceleration at both ends.

    From rest to rest it is the motion with the least jerk. Nothing bounds what is in between: ask `peaks`.
    """

    def __init__(
        self,
        start: ArrayLike,
        end: ArrayLike,
        duration: ArrayLike,
        *,
        start_velocity: ArrayLike = 0.0,
        start_acceleration: ArrayLike = 0.0,
        end_velocity: ArrayLike = 0.0,
        end_acceleration: ArrayLike = 0.0,
    ) -> None:
        """Lead from state to state.

        Args:
            start: Positions, shape (..., n), in any unit, such as joints [rad].
            end: The same at the end.
            duration: How long it takes [s], shape (...), above 0.
            start_velocity: In the unit per second, shape (..., n) or a number.
            start_acceleration: In the unit per second squared.
            end_velocity: As at the start.
            end_acceleration: As at the start.

        Raises:
            InvalidSetup: A duration is not above 0, or a number is not finite.
        """
        self.duration = _duration(duration)
        states = (start, end, start_velocity, end_velocity, start_acceleration, end_acceleration)
        p0, p1, v0, v1, a0, a1 = np.broadcast_arrays(*(np.asarray(state, np.float64) for state in states))
        if not all(np.isfinite(state).all() for state in (p0, p1, v0, v1, a0, a1)):
            raise InvalidSetup("Quintic: positions, velocities and accelerations must be finite numbers.")
        # In shares of the time, so that the coefficients are of the size of the way.
        t = self.duration[..., None]
        v0, v1, a0, a1, way = v0 * t, v1 * t, a0 * t * t, a1 * t * t, p1 - p0
        self._coefficients: list[Numbers] = [
            *np.broadcast_arrays(
                p0,
                v0,
                0.5 * a0,
                10 * way - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1,
                -15 * way + 8 * v0 + 7 * v1 + 1.5 * a0 - a1,
                6 * way - 3 * (v0 + v1) + 0.5 * (a1 - a0),
            )
        ]

    def position(self, time: ArrayLike) -> Numbers:
        """Return positions after times [s], shape (...), as (..., n)."""
        return self._at(time, 0)

    def velocity(self, time: ArrayLike) -> Numbers:
        """Return velocities after times [s], shape (...), as (..., n): those of the ends before and after."""
        return self._at(time, 1)

    def acceleration(self, time: ArrayLike) -> Numbers:
        """Return accelerations after times [s], shape (...), as (..., n): those of the ends before and after."""
        return self._at(time, 2)

    def jerk(self, time: ArrayLike) -> Numbers:
        """Return the derivatives of the accelerations after times [s], shape (...), as (..., n)."""
        return self._at(time, 3)

    def peaks(self) -> tuple[Numbers, Numbers, Numbers]:
        """Return the largest speed, acceleration and jerk of each number on the way, without sign, (..., n) each.

        They are looked for at a thousand times.
        """
        moments = np.linspace(0.0, 1.0, 1000)
        most = [np.zeros(np.shape(self._coefficients[0])) for _ in range(3)]
        for moment in moments:
            for i, largest in enumerate(most):
                np.maximum(largest, np.abs(self._at(moment * self.duration, i + 1)), out=largest)
        return most[0], most[1], most[2]

    def _at(self, time: ArrayLike, derivative: int) -> Numbers:
        x = np.clip(np.asarray(time, np.float64) / self.duration, 0.0, 1.0)[..., None]
        value: Numbers = np.zeros(())
        for power in range(5, derivative - 1, -1):
            factor = float(np.prod(np.arange(power - derivative + 1, power + 1)))
            value = value * x + factor * self._coefficients[power]
        return value / self.duration[..., None] ** derivative


class PoseLine:
    """The straight way of a TCP from pose to pose: the translation on a line, the rotation about one axis, together."""

    def __init__(
        self,
        start: ArrayLike,
        end: ArrayLike,
        *,
        speed: float,
        turn_speed: float,
        law: Law = "minimum_jerk",
    ) -> None:
        """Take as long as the slower of translation and rotation needs.

        Args:
            start: TCP poses as tquat, shape (..., 7): m, xyzw.
            end: TCP poses as tquat, shape (..., 7).
            speed: Largest speed of the translation [m/s].
            turn_speed: Largest speed of the rotation [rad/s].
            law: `minimum_jerk` from rest to rest, or `linear` for constant speed.

        Raises:
            InvalidSetup: A speed is not above 0, or the law is unknown.
        """
        if not (speed > 0 and turn_speed > 0 and np.isfinite([speed, turn_speed]).all()):
            raise InvalidSetup(f"PoseLine: speeds are {speed:g} m/s and {turn_speed:g} rad/s; they must be above 0.")
        if law not in get_args(Law):
            raise InvalidSetup(f"PoseLine: law is {law!r}; valid: {', '.join(map(repr, get_args(Law)))}.")
        self._law: Law = law
        self.start, self.end = normalize(start), normalize(end)
        self._way = _motion(self.start, self.end)
        """Translation [m] and rotation vector [rad], (..., 6)."""
        lengths = np.sqrt((self._way.reshape(*self._way.shape[:-1], 2, 3) ** 2).sum(axis=-1))
        self.duration: Numbers = PEAK_SPEED[law] * (lengths / np.array([speed, turn_speed])).max(axis=-1)
        """How long it takes [s], shape (...); 0 for a way of no length."""

    def pose(self, time: ArrayLike) -> Numbers:
        """Return TCP poses after times [s], shape (...), as tquat, (..., 7)."""
        x = self._fraction(time)
        return interpolate(self.start, self.end, minimum_jerk(x) if self._law == "minimum_jerk" else x)

    def twist(self, time: ArrayLike) -> Numbers:
        """Return twists after times [s], shape (...), as (..., 6): linear [m/s] and angular velocity [rad/s].

        They are along and about the axes of the frame of the poses, and 0 before the start and after the end.
        """
        now = np.asarray(time, np.float64)
        x = self._fraction(now)
        if self._law == "minimum_jerk":
            rate = _minimum_jerk_rate(x)
        else:
            rate = np.where((now >= 0.0) & (now < self.duration), 1.0, 0.0)
        return (rate / np.where(self.duration > 0, self.duration, 1.0))[..., None] * self._way

    def _fraction(self, time: ArrayLike) -> Numbers:
        now = np.asarray(time, np.float64)
        shares = now / np.where(self.duration > 0, self.duration, 1.0)
        return np.where(self.duration > 0, np.clip(shares, 0.0, 1.0), (now >= 0.0).astype(np.float64))


def _motion(start: Numbers, end: Numbers) -> Numbers:
    """Return translations [m] and rotation vectors [rad], (..., 6), along and about the axes of the parent frame."""
    turn = compose(_turn_of(end), inverse(_turn_of(start)))[..., 3:]
    turn = np.where(turn[..., 3:] < 0, -turn, turn)
    sine = np.sqrt((turn[..., :3] ** 2).sum(axis=-1, keepdims=True))
    angle_per_sine = np.where(sine > 1e-9, 2 * np.arctan2(sine, turn[..., 3:]) / np.maximum(sine, 1e-9), 2.0)
    return np.concatenate(np.broadcast_arrays(end[..., :3] - start[..., :3], turn[..., :3] * angle_per_sine), axis=-1)


def _turn_of(pose: Numbers) -> Numbers:
    turn = pose.copy()
    turn[..., :3] = 0.0
    return turn


def _duration(duration: ArrayLike) -> Numbers:
    own = np.asarray(duration, np.float64)
    if not (np.isfinite(own) & (own > 0)).all():
        raise InvalidSetup(f"duration is {duration!r} s; it must be above 0.")
    return own
