"""Paths and their times: limits hold at every moment, the motion is smooth, and it follows the path."""

from __future__ import annotations

import numpy as np
import pytest

from rcs._core import LineProfile
from rcs.errors import InvalidSetup
from rcs.planning import JointLimits, Path, TimedPath, diversity, time_path
from rcs.robots import FR3


def test_points_on_a_path_lie_at_their_share_of_the_length() -> None:
    path = Path([[0.0, 0.0], [3.0, 0.0], [3.0, 1.0]])
    assert path.length == 4.0
    np.testing.assert_allclose(path.at([0.0, 0.5, 0.75, 1.0]), [[0, 0], [2, 0], [3, 0], [3, 1]])


def test_a_path_keeps_its_own_waypoints() -> None:
    rows = np.zeros((2, 3))
    path = Path(rows)
    rows[0] = 1.0
    assert not path.waypoints.any()
    with pytest.raises(ValueError, match="read-only"):
        path.waypoints[0] = 1.0


@pytest.mark.parametrize("rows", [np.zeros((1, 3)), np.zeros(3), np.full((2, 2), np.nan)])
def test_what_is_no_path_is_refused(rows: np.ndarray) -> None:
    with pytest.raises(InvalidSetup, match="waypoints"):
        Path(rows)


def test_straight_ways_do_not_differ_whatever_their_ends_and_ways_around_do() -> None:
    straight = [Path([[0.0, 0.0], [1.0, end]]) for end in (0.0, 1.0, 2.0)]
    assert diversity(straight) == pytest.approx(0.0, abs=1e-12)
    around = [Path([[0.0, 0.0], [0.5, side], [1.0, 0.0]]) for side in (-0.5, 0.5)]
    assert diversity(around) > 0.4
    assert diversity(around) == diversity(around[::-1])
    with pytest.raises(InvalidSetup, match="at least 2"):
        diversity(around[:1])


LIMITS = JointLimits.of(FR3)


def random_path(seed: int, count: int = 6) -> Path:
    return Path(np.random.default_rng(seed).uniform(FR3.joint_lower, FR3.joint_upper, (count, 7)))


@pytest.mark.parametrize("seed", range(20))
def test_limits_hold_at_every_sample(seed: int) -> None:
    path = random_path(seed) if seed % 2 else Path(0.01 * random_path(seed, 12).waypoints)
    samples = time_path(path, LIMITS, bend=[0.05, 0.3, 2.0][seed % 3]).sampled(2000.0)
    for values, limit in [
        (samples.velocities, LIMITS.velocity),
        (samples.accelerations, LIMITS.acceleration),
        (samples.jerks, LIMITS.jerk),
    ]:
        assert (np.abs(values) <= limit).all()
    np.testing.assert_allclose(samples.positions[[0, -1]], path.waypoints[[0, -1]], atol=1e-9)
    for values in (samples.velocities, samples.accelerations):
        np.testing.assert_allclose(values[[0, -1]], 0.0, atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_velocities_accelerations_and_jerks_are_the_derivatives(seed: int) -> None:
    timed = time_path(random_path(seed), LIMITS)
    times = np.linspace(0.0, timed.duration, 400)[1:-1]
    h = 1e-6
    middle, before, after = timed.at(times), timed.at(times - h), timed.at(times + h)
    np.testing.assert_allclose((after.positions - before.positions) / (2 * h), middle.velocities, atol=1e-5)
    np.testing.assert_allclose((after.velocities - before.velocities) / (2 * h), middle.accelerations, atol=1e-2)
    # A jerk jumps where phases meet; elsewhere it is the derivative of the acceleration.
    rate = (after.accelerations - before.accelerations) / (2 * h)
    assert (np.abs(rate - middle.jerks) < 1e-1).all(axis=1).mean() > 0.97


def gentle_path(seed: int) -> Path:
    way = np.random.default_rng(seed).uniform(0.1, 0.3, 7)
    turns = 0.05 * np.random.default_rng(seed + 1).normal(size=(6, 7))
    return Path(np.cumsum(way + turns, axis=0) - 1.0)


def test_bends_leave_the_path_by_no_more_than_their_length_and_take_less_time_than_stops() -> None:
    path = gentle_path(1)
    stopping, bending = time_path(path, LIMITS, bend=0.0), time_path(path, LIMITS, bend=0.4)
    assert bending.duration < 0.8 * stopping.duration
    on_path = path.at(np.linspace(0.0, 1.0, 4000))
    for position in bending.sampled(100.0).positions:
        assert np.linalg.norm(on_path - position, axis=1).min() < 0.4 / 4 + 0.01
    exact = stopping.sampled(100.0).positions
    assert max(np.linalg.norm(on_path - position, axis=1).min() for position in exact) < 0.01


def test_bends_are_never_slower_than_stops_and_what_is_not_free_is_shortened() -> None:
    for seed in range(10):
        sharp = random_path(seed)
        assert time_path(sharp, LIMITS).duration <= time_path(sharp, LIMITS, bend=0.0).duration
    path = gentle_path(2)
    assert time_path(path, LIMITS, is_free=lambda _: False).duration == time_path(path, LIMITS, bend=0.0).duration
    corner = path.waypoints[1]
    near = time_path(path, LIMITS, is_free=lambda rows: bool(np.linalg.norm(rows - corner, axis=1).max() < 0.06))
    assert time_path(path, LIMITS, bend=0.3).duration < near.duration < time_path(path, LIMITS, bend=0.0).duration


def test_half_the_speed_takes_twice_the_time() -> None:
    path = random_path(3)
    whole, half = (time_path(path, JointLimits.of(FR3, scale=scale)).duration for scale in (1.0, 0.5))
    assert half == pytest.approx(2.0 * whole, rel=1e-6)


def test_a_path_that_goes_nowhere_takes_no_time() -> None:
    timed = time_path(Path(np.ones((3, 7))), LIMITS)
    assert timed.duration == 0.0
    np.testing.assert_array_equal(timed.sampled(30.0).positions, np.ones((1, 7)))


def test_outside_of_its_time_a_path_stands_still() -> None:
    timed: TimedPath = time_path(random_path(4), LIMITS)
    samples = timed.at([-1.0, timed.duration + 1.0])
    assert not samples.velocities.any()
    np.testing.assert_allclose(samples.positions, random_path(4).waypoints[[0, -1]], atol=1e-9)


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="joints"):
        time_path(Path(np.zeros((2, 3))), LIMITS)
    with pytest.raises(InvalidSetup, match="scale"):
        JointLimits.of(FR3, scale=1.5)
    with pytest.raises(InvalidSetup, match="rate"):
        time_path(random_path(0), LIMITS).sampled(0.0)
    with pytest.raises(InvalidSetup, match="velocity"):
        JointLimits(velocity=np.array([0.0]), acceleration=np.array([1.0]), jerk=np.array([1.0]))


@pytest.mark.parametrize(("start", "end"), [(0.0, 0.0), (0.5, 1.0), (1.0, 0.2), (2.0, 2.0)])
def test_a_line_is_gone_from_speed_to_speed_forwards_and_within_limits(start: float, end: float) -> None:
    profile = LineProfile(3.0, start, end, velocity=2.0, acceleration=5.0, jerk=40.0)
    motion = profile.at(np.linspace(0.0, profile.duration, 1000))
    way, velocity, acceleration, jerk = motion.T
    assert (np.diff(way) >= 0.0).all()
    np.testing.assert_allclose([way[0], way[-1], velocity[0], velocity[-1]], [0.0, 3.0, start, end], atol=1e-9)
    assert velocity.max() <= 2.0 + 1e-9
    assert np.abs(acceleration).max() <= 5.0 + 1e-9
    assert np.abs(jerk).max() <= 40.0 + 1e-9


def test_the_fastest_speed_over_a_distance_is_reached_and_a_higher_one_is_not() -> None:
    limits = {"velocity": 10.0, "acceleration": 5.0, "jerk": 40.0}
    fastest = LineProfile.fastest(0.3, 0.2, **limits)
    LineProfile(0.2, 0.3, fastest, **limits)
    with pytest.raises(InvalidSetup, match="too short"):
        LineProfile(0.2, 0.3, 1.02 * fastest, **limits)
