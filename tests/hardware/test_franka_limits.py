"""Limits of an FR3: how fast its joints may go where."""

from __future__ import annotations

import numpy as np
import pytest

from rcs.hardware.franka_limits import limits_of_fr3, velocity_bounds
from rcs.robots import FR3


def test_a_joint_that_brakes_for_the_end_of_its_range_is_never_too_fast_for_its_place():
    limits = limits_of_fr3(FR3)
    for speed in np.linspace(0.0, 1.0, 50)[:, None] * limits.joint_velocity:
        way = speed**2 / (2.0 * np.array(FR3.acceleration_limit))
        assert (1.05 * speed <= velocity_bounds(FR3, limits.joint_upper - way)[1] + 1e-3).all()
        assert (-1.05 * speed >= velocity_bounds(FR3, limits.joint_lower + way)[0] - 1e-3).all()


def test_the_range_that_is_left_has_room_for_work():
    limits, home = limits_of_fr3(FR3), np.array(FR3.home)
    assert (limits.joint_lower < home - 0.4).all()
    assert (limits.joint_upper > home + 0.4).all()
    assert (limits.joint_upper - limits.joint_lower > 0.7 * (np.array(FR3.joint_upper) - FR3.joint_lower)).all()


def test_a_share_of_the_speed_leaves_more_of_the_range():
    full, slow = limits_of_fr3(FR3), limits_of_fr3(FR3, speed=0.05)
    assert slow.joint_velocity == pytest.approx(0.05 * full.joint_velocity)
    assert (slow.joint_lower <= full.joint_lower).all()
    assert slow.joint_upper[1] > full.joint_upper[1] + 0.4


def test_the_whole_range_is_that_of_the_description():
    limits = limits_of_fr3(FR3, whole_range=True)
    assert limits.joint_lower == pytest.approx(FR3.joint_lower)
    assert limits.joint_velocity == pytest.approx(FR3.velocity_limit)
    least, most = velocity_bounds(FR3, np.array(FR3.joint_upper))
    assert most == pytest.approx(np.zeros(7)), "at the very end, only back"
    assert (least < 0).all()
