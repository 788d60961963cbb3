"""Arms on a clock: where they are depends on when targets came, not on who looks when."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rcs.errors import InvalidSetup, UnknownName
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.robots.so101 import SO101
from rcs.robots.ur5e import UR5E
from rcs.robots.xarm7 import XARM7
from rcs.sim.scene import RobotPlacement
from rcs.sim.timed_world import LONGEST_GAP, SMOOTHING, Course, TimedWorld

HOME = np.array(FR3.home)
PLACEMENT = RobotPlacement(name="arm", arm=FR3, gripper=FRANKA_HAND)


def swing(world: TimedWorld, *, shift: float = 0.0, jitter: float = 0.0, seconds: float = 3.0) -> np.ndarray:
    """Return the joints at every physics step of a smooth motion whose targets come at 30 Hz."""
    random, path = np.random.default_rng(0), []
    for step in range(1, round(30 * seconds)):
        goal = HOME + 0.15 * (1 - np.cos(np.pi * step / 45))
        world.command("arm", goal, at=step / 30 + shift + random.uniform(0, jitter))
        world.advance_to((step + 1) / 30 + shift, lambda: path.append(world.arms["arm"].joints))
    return np.array(path)


def test_targets_that_come_later_by_whole_steps_give_the_same_motion_later() -> None:
    now, later = swing(TimedWorld([PLACEMENT])), swing(TimedWorld([PLACEMENT]), shift=0.03)
    np.testing.assert_allclose(later[15:], now[: len(later) - 15], atol=1e-9)


def test_a_millisecond_of_jitter_changes_the_motion_by_less_than_what_is_driven_in_it() -> None:
    now, later = swing(TimedWorld([PLACEMENT])), swing(TimedWorld([PLACEMENT]), jitter=1e-3)
    fastest = 0.15 * np.pi * 30 / 45
    assert np.abs(now - later).max() < 1.1e-3 * fastest


@pytest.mark.parametrize("arm", [FR3, XARM7, UR5E, SO101], ids=lambda arm: arm.name)
def test_a_target_is_led_to_a_far_goal_within_the_limits_and_hardly_beyond_it(arm: Any) -> None:
    home = np.array(arm.home)
    middle = (np.array(arm.joint_lower) + np.array(arm.joint_upper)) / 2
    course = Course(arm, home, SMOOTHING)
    course.due.append((0.0, middle))
    path = np.array([course.advance(0.002 * step, 0.002) for step in range(5000)])
    velocity = np.diff(path, axis=0) / 0.002
    assert (np.abs(velocity) <= np.array(arm.velocity_limit)).all()
    assert (np.abs(np.diff(velocity, axis=0) / 0.002) <= np.array(arm.acceleration_limit)).all()
    np.testing.assert_allclose(path[-1], middle, atol=1e-6)
    beyond = (path - middle) * np.sign(middle - home)
    assert beyond.max() < 0.03


def test_a_servo_keeps_up_with_its_target() -> None:
    world = TimedWorld([PLACEMENT])
    errors = []
    for step in range(1, 90):
        world.command("arm", HOME + 0.15 * (1 - np.cos(np.pi * step / 45)), at=step / 30)
        world.advance_to((step + 1) / 30)
        errors.append(world.arms["arm"].joints - world.arms["arm"].course.target)
    assert np.abs(errors).max() < 3e-3


def test_after_a_long_pause_the_arm_stands_at_its_goal() -> None:
    world = TimedWorld([PLACEMENT])
    world.command("arm", HOME + 0.2, at=0.1)
    world.advance_to(LONGEST_GAP + 1.0)
    np.testing.assert_allclose(world.arms["arm"].joints, HOME + 0.2)
    assert world.time == LONGEST_GAP + 1.0


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="smoothing is 0"):
        TimedWorld([PLACEMENT], smoothing=0.0)
    with pytest.raises(UnknownName, match="Known: arm"):
        TimedWorld([PLACEMENT]).command("amr", HOME, at=0.0)
