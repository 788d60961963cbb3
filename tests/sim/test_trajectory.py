"""The law of motion: a target never makes a joint go away from it, and none passes it by more than 0.03 rad."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from rcs._core import MotionLimits, Trajectory
from rcs.envs.layers import LimitStep
from rcs.errors import InvalidSetup
from rcs.robots.description import ArmDescription
from rcs.robots.fr3 import FR3
from rcs.robots.so101 import SO101
from rcs.robots.ur5e import UR5E
from rcs.robots.xarm7 import XARM7

ARMS = {arm.name: arm for arm in (FR3, UR5E, XARM7, SO101)}
FREQUENCIES = (10.0, 30.0, 100.0)
TICKS = 8
"""Places of a step that are looked at."""
PROMISE = 0.03
"""By how much a target may be passed [rad]."""


class Led:
    """An arm that follows its trajectory exactly, behind the layer that bounds targets."""

    def __init__(self, arm: ArmDescription, frequency: float, *, start: NDArray[np.float64] | None = None) -> None:
        limits = arm.motion_limits
        self.arm, self.period, self.trajectory = arm, 1.0 / frequency, Trajectory(limits)
        self.memory = np.zeros(Trajectory.size(arm.dof))
        self.start = np.array(arm.home) if start is None else start
        for row in Trajectory.POSITION_ROWS:
            self.memory[row * arm.dof : (row + 1) * arm.dof] = self.start
        self.limit = LimitStep(np.array(arm.velocity_limit) / frequency, np.array(limits.lead(self.period)))
        self.limit.reset({"joints": self.start})
        self.rows: list[NDArray[np.float64]] = []

    def go(self, target: NDArray[np.float64], steps: int) -> NDArray[np.float64]:
        """Ask for a target in every step; return position, velocity and acceleration, (n, 3, dof)."""
        rows: list[NDArray[np.float64]] = []
        for _ in range(steps):
            self.limit.map_observation({"joints": self.state[0]})
            asked = self.limit.map_executed(self.limit.map_action({"joints": target}))["joints"]
            self.memory[: self.arm.dof] = asked
            self.trajectory.follow(self.memory, self.period)
            rows += [self.trajectory.state(self.memory, k * self.period / TICKS) for k in range(TICKS)]
            self.trajectory.advance(self.memory, self.period)
        return np.array([*rows, self.state])

    @property
    def state(self) -> NDArray[np.float64]:
        return self.trajectory.state(self.memory)


def sizes(arm: ArmDescription, joint: int, sign: int) -> NDArray[np.float64]:
    """Ten ways of a joint from home, up to the end of its range [rad]."""
    edge = (arm.joint_upper if sign > 0 else arm.joint_lower)[joint] - arm.home[joint]
    return edge * np.concatenate([0.005 * 2.5 ** np.arange(4), np.linspace(0.2, 1.0, 6)])


def turns(acceleration: NDArray[np.float64], limit: float) -> int:
    """How often an acceleration changes its sign."""
    signs = np.sign(acceleration[np.abs(acceleration) > 0.02 * limit])
    return int(np.count_nonzero(np.diff(signs)))


@pytest.mark.parametrize("frequency", FREQUENCIES)
@pytest.mark.parametrize("name", ARMS)
def test_a_move_goes_the_right_way_and_past_its_target_by_no_more_than_promised(name: str, frequency: float) -> None:
    arm = ARMS[name]
    for joint, sign in itertools.product(range(arm.dof), (1, -1)):
        for size in sizes(arm, joint, sign):
            if abs(size) < 1e-6:
                continue
            led = Led(arm, frequency)
            target = led.start.copy()
            target[joint] += size
            steps = int((abs(size) / arm.velocity_limit[joint] + 1.3) * frequency)
            rows = led.go(target, steps)
            way = sign * (rows[:, 0, joint] - led.start[joint])
            words = f"{name} joint {joint} by {size:.3f} rad"
            assert way.min() >= -1e-9, words
            assert way.max() <= abs(size) + PROMISE, words

            assert turns(rows[:, 2, joint], arm.acceleration_limit[joint]) <= 3, words
            np.testing.assert_allclose(rows[-1, 0], target, atol=1e-9, err_msg=words)
            assert np.all(np.abs(np.delete(rows[:, 0] - led.start, joint, axis=1)) <= 1e-9), words


@pytest.mark.parametrize(
    ("name", "joint", "way", "seconds"), [("fr3", 4, 2.71, 1.15), ("ur5e", 0, 7.75, 3.5)], ids=["fr3", "ur5e"]
)
def test_a_far_move_comes_to_full_speed(name: str, joint: int, way: float, seconds: float) -> None:
    led = Led(ARMS[name], 30.0)
    target = led.start.copy()
    target[joint] += way
    rows = led.go(target, 120)
    late = np.flatnonzero(np.abs(rows[:, 0, joint] - target[joint]) > 1e-3)[-1]
    assert late * led.period / TICKS <= seconds


@pytest.mark.parametrize("frequency", FREQUENCIES)
@pytest.mark.parametrize("name", ARMS)
def test_from_motion_a_joint_brakes_first_if_it_goes_away_and_still_stops_at_its_target(
    name: str, frequency: float
) -> None:
    arm = ARMS[name]
    draws = np.random.default_rng(0)
    for joint in list(range(arm.dof)) * 6:
        led = Led(arm, frequency)
        lower, upper = arm.joint_lower[joint], arm.joint_upper[joint]
        first, target = led.start.copy(), led.start.copy()
        first[joint], target[joint] = draws.uniform(lower, upper, 2)
        led.go(first, int(draws.integers(1, int(frequency) + 1)))
        start = led.state[:, joint]
        braking = led.memory.copy()
        led.trajectory.brake(braking)
        stop = abs(braking[joint] - start[0])
        ahead = np.sign(target[joint] - start[0])
        way, speed = ahead * (led.go(target, int(5 * frequency))[:, 0, joint] - start[0]), ahead * start[1]
        size = abs(target[joint] - start[0])
        assert way.min() >= -1e-3 - (stop if speed < 0 else 0.0)
        # Where the new target is nearer than the joint can stop, it is passed by what braking takes.
        assert way.max() <= max(size, stop if speed > 0 else 0.0) + PROMISE
        np.testing.assert_allclose(way[-1], size, atol=1e-6)


@pytest.mark.parametrize("name", ARMS)
def test_a_stream_that_ends_at_any_speed_is_passed_by_no_more_than_promised(name: str) -> None:
    arm = ARMS[name]
    for share in (0.1, 0.3, 0.5, 0.7, 0.9):
        led = Led(arm, 30.0)
        joint = 0
        target = led.start.copy()
        for _ in range(25):
            target[joint] += share * arm.velocity_limit[joint] / 30.0
            led.go(target, 1)
        rows = led.go(target, 60)
        assert rows[:, 0, joint].max() <= target[joint] + PROMISE
        assert turns(rows[:, 2, joint], arm.acceleration_limit[joint]) <= 3


def test_braking_is_straight_and_once_begun_goes_on() -> None:
    led = Led(FR3, 30.0)
    led.go(np.array(FR3.home) + 1.0, 10)
    start = led.state
    led.trajectory.brake(led.memory)
    end = led.memory[:7].copy()
    places = [led.state[0]]
    for _ in range(60):
        led.trajectory.brake(led.memory)
        led.trajectory.advance(led.memory, 0.01)
        places.append(led.state[0])
    along = start[1] / np.linalg.norm(start[1])
    offsets = np.array(places) - start[0]
    np.testing.assert_allclose(offsets - np.outer(offsets @ along, along), 0.0, atol=2e-3)
    np.testing.assert_allclose(places[-1], end, atol=1e-9)
    np.testing.assert_array_equal(led.state[1:], 0.0)


def test_targets_may_lead_by_what_the_arm_needs_to_stop() -> None:
    limits = MotionLimits([-3.0], [3.0], [2.0], [10.0], [1e9])
    np.testing.assert_allclose(limits.lead(0.1), 2.0**2 / 10.0 + 0.2 * 2.0, rtol=1e-3)
    with pytest.raises(InvalidSetup, match="period must be positive"):
        limits.lead(0.0)


def test_memory_of_another_size_is_refused() -> None:
    trajectory = Trajectory(FR3.motion_limits)
    with pytest.raises(InvalidSetup, match="the memory has 7 numbers, valid are 61"):
        trajectory.state(np.zeros(7))
    with pytest.raises(InvalidSetup, match="period above 0"):
        trajectory.follow(np.zeros(Trajectory.size(7)), 0.0)


def test_a_joint_outside_its_range_may_stay_goes_no_farther_and_comes_back() -> None:
    start = np.array(FR3.home)
    start[3] = FR3.joint_upper[3] + 0.2
    led = Led(FR3, 30.0, start=start)
    led.limit = LimitStep(np.full(FR3.dof, 10.0), np.full(FR3.dof, 10.0))
    led.limit.reset({"joints": start})
    np.testing.assert_array_equal(led.go(start, 10)[:, 0], np.tile(start, (10 * TICKS + 1, 1)))
    farther = start.copy()
    farther[3] += 0.5
    assert led.go(farther, 10)[:, 0, 3].max() <= start[3]
    led.trajectory.brake(led.memory)
    led.trajectory.advance(led.memory, 1.0)
    np.testing.assert_allclose(led.state[0], start, atol=1e-9)
    home = np.array(FR3.home)
    way = led.go(home, 60)[:, 0, 3]
    assert np.all(np.diff(way) <= 1e-9)
    assert way[-1] == pytest.approx(home[3], abs=1e-9)


def test_memory_that_would_be_copied_is_refused() -> None:
    trajectory = Trajectory(FR3.motion_limits)
    size = Trajectory.size(7)
    for memory in (np.zeros((size, 2))[:, 0], np.zeros(size, np.float32), [0.0] * size):
        with pytest.raises(TypeError):
            trajectory.follow(memory, 0.1)  # pyright: ignore[reportArgumentType]
