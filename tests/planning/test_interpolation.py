from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.planning import PoseLine, Quintic, minimum_jerk
from rcs.spatial import Pose, distance, normalize

RNG = np.random.default_rng(0)
START, END = (RNG.normal(size=(5, 7)) for _ in range(2))


def slope(curve: Any, time: Any, step: float = 1e-5) -> np.ndarray:
    return (curve(time + step) - curve(time - step)) / (2 * step)


def test_the_share_of_a_way_grows_from_0_to_1_and_starts_and_ends_at_rest_without_acceleration() -> None:
    times = np.linspace(0.0, 1.0, 101)
    share = minimum_jerk(times)
    assert share[0] == 0.0
    assert share[-1] == 1.0
    assert (np.diff(share) > 0).all()
    np.testing.assert_allclose(share + minimum_jerk(1.0 - times), 1.0, atol=1e-12)  # there as back
    np.testing.assert_allclose(slope(minimum_jerk, np.array([0.0, 1.0])), 0.0, atol=1e-8)
    second = minimum_jerk(np.array([2e-4, 1.0])) - 2 * minimum_jerk(np.array([1e-4, 1.0 - 1e-4]))
    second += minimum_jerk(np.array([0.0, 1.0 - 2e-4]))
    np.testing.assert_allclose(second / 1e-8, 0.0, atol=0.01)
    np.testing.assert_allclose(slope(minimum_jerk, np.array(0.5)), 15 / 8, atol=1e-8)
    np.testing.assert_array_equal(minimum_jerk([-1.0, 2.0]), [0.0, 1.0])


def test_no_other_motion_from_rest_to_rest_has_less_jerk() -> None:
    times = np.linspace(0.0, 1.0, 4001)

    def jerk(position: np.ndarray) -> float:
        return float((np.diff(position, 3) ** 2).sum())

    least = jerk(minimum_jerk(times))
    for power in (3, 4, 5):
        bump = (times * (1.0 - times)) ** power
        for size in (-0.5, 0.5):
            assert jerk(minimum_jerk(times) + size * bump) > least


def states() -> dict[str, np.ndarray]:
    names = ("start_velocity", "start_acceleration", "end_velocity", "end_acceleration")
    return {name: RNG.normal(size=(5, 3)) for name in names}


def test_a_quintic_meets_both_states_and_its_derivatives_are_derivatives() -> None:
    start, end, more = RNG.normal(size=(5, 3)), RNG.normal(size=(5, 3)), states()
    duration = np.array([0.3, 0.5, 1.0, 2.0, 4.0])
    way = Quintic(start, end, duration, **more)
    for time, at in ((np.zeros(5), "start"), (duration, "end")):
        np.testing.assert_allclose(way.position(time), start if at == "start" else end, atol=1e-12)
        np.testing.assert_allclose(way.velocity(time), more[f"{at}_velocity"], atol=1e-11)
        np.testing.assert_allclose(way.acceleration(time), more[f"{at}_acceleration"], atol=1e-10)
    inside = 0.37 * duration
    np.testing.assert_allclose(slope(way.position, inside), way.velocity(inside), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(slope(way.velocity, inside), way.acceleration(inside), rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(slope(way.acceleration, inside), way.jerk(inside), rtol=1e-5, atol=1e-4)


def test_from_rest_to_rest_a_quintic_is_the_motion_of_least_jerk() -> None:
    start, end, times = np.array([0.2, -1.0]), np.array([1.0, 2.0]), np.linspace(-0.5, 2.5, 31)
    way = Quintic(start, end, 2.0)
    expected = start + (end - start) * minimum_jerk(times / 2.0)[:, None]
    np.testing.assert_allclose(way.position(times), expected, atol=1e-12)
    speed, acceleration, jerk = way.peaks()
    np.testing.assert_allclose(speed, 15 / 8 * np.abs(end - start) / 2.0, rtol=1e-5)
    np.testing.assert_allclose(acceleration, 10 / np.sqrt(3) * np.abs(end - start) / 4.0, rtol=1e-5)
    np.testing.assert_allclose(jerk, 60 * np.abs(end - start) / 8.0, rtol=1e-5)


def test_many_quintics_are_one_by_one() -> None:
    start, end, more = RNG.normal(size=(5, 3)), RNG.normal(size=(5, 3)), states()
    duration, time = RNG.uniform(0.5, 2.0, 5), RNG.uniform(-0.1, 2.1, 5)
    together = Quintic(start, end, duration, **more)
    for i in range(5):
        alone = Quintic(start[i], end[i], duration[i], **{name: value[i] for name, value in more.items()})
        np.testing.assert_array_equal(together.position(time)[i], alone.position(time[i]))
        np.testing.assert_array_equal(together.acceleration(time)[i], alone.acceleration(time[i]))


@pytest.mark.parametrize("law", ["linear", "minimum_jerk"])
def test_a_line_is_straight_turns_about_one_axis_and_keeps_its_speeds(law: Any) -> None:
    line = PoseLine(START[0], END[0], speed=0.3, turn_speed=0.8, law=law)
    times = np.linspace(0.0, float(line.duration), 200)
    poses, twists = line.pose(times), line.twist(times)
    assert distance(poses[0], normalize(START[0])).max() < 1e-7
    assert distance(poses[-1], normalize(END[0])).max() < 1e-7
    way = END[0][:3] - START[0][:3]
    along = (poses[:, :3] - START[0][:3]) @ way / (way @ way)
    np.testing.assert_allclose(poses[:, :3], START[0][:3] + along[:, None] * way, atol=1e-12)
    whole = distance(normalize(START[0]), normalize(END[0]))[1]
    np.testing.assert_allclose(distance(normalize(START[0]), poses)[:, 1], along * whole, atol=1e-7)
    speeds = np.linalg.norm(twists[:, :3], axis=-1), np.linalg.norm(twists[:, 3:], axis=-1)
    shares = speeds[0].max() / 0.3, speeds[1].max() / 0.8
    assert max(shares) <= 1 + 1e-9
    np.testing.assert_allclose(max(shares), 1.0, atol=1e-3)


@pytest.mark.parametrize("law", ["linear", "minimum_jerk"])
def test_a_twist_is_the_derivative_of_the_pose(law: Any) -> None:
    line = PoseLine(START[1], END[1], speed=0.3, turn_speed=0.8, law=law)
    for share in (0.1, 0.5, 0.8):
        time, step = share * float(line.duration), 1e-5
        before, after = (Pose.from_tquat(line.pose(time + sign * step)) for sign in (-1, 1))
        turn = Pose([0, 0, 0], after.quaternion) * Pose([0, 0, 0], before.quaternion).inverse()
        measured = np.append(after.translation - before.translation, turn.rotvec) / (2 * step)
        np.testing.assert_allclose(line.twist(time), measured, atol=1e-6)


def test_a_line_stands_still_before_and_after_and_where_there_is_no_way() -> None:
    line = PoseLine(START, END, speed=0.3, turn_speed=0.8)
    assert line.duration.shape == (5,)
    for time in (np.full(5, -1.0), line.duration, line.duration + 1.0):
        np.testing.assert_allclose(line.twist(time), 0.0, atol=1e-9)
    assert distance(line.pose(line.duration + 1.0), normalize(END)).max() < 1e-7
    nowhere = PoseLine(START[0], START[0], speed=0.3, turn_speed=0.8)
    assert nowhere.duration < 1e-6
    assert distance(nowhere.pose(1.0), normalize(START[0])).max() < 1e-7
    np.testing.assert_array_equal(nowhere.twist(1.0), np.zeros(6))


def test_many_lines_are_one_by_one() -> None:
    together, time = PoseLine(START, END, speed=0.3, turn_speed=0.8), RNG.uniform(0.0, 3.0, 5)
    for i in range(5):
        alone = PoseLine(START[i], END[i], speed=0.3, turn_speed=0.8)
        np.testing.assert_array_equal(together.duration[i], alone.duration)
        np.testing.assert_array_equal(together.pose(time)[i], alone.pose(time[i]))
        np.testing.assert_array_equal(together.twist(time)[i], alone.twist(time[i]))


def test_what_makes_no_sense_is_refused() -> None:
    for duration in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InvalidSetup, match="must be above 0"):
            Quintic([0.0], [1.0], duration)
    with pytest.raises(InvalidSetup, match="finite"):
        Quintic([np.nan], [1.0], 1.0)
    with pytest.raises(InvalidSetup, match="speeds are 0 m/s"):
        PoseLine(START, END, speed=0.0, turn_speed=1.0)
    unknown: Any = "cubic"
    with pytest.raises(InvalidSetup, match="valid: 'linear', 'minimum_jerk'"):
        PoseLine(START, END, speed=1.0, turn_speed=1.0, law=unknown)
