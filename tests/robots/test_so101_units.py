"""LeRobot's units for the SO101: round trips, ends of the ranges, cutting."""

from __future__ import annotations

import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.robots.so101.description import SO101
from rcs.robots.so101.units import (
    RANGE_LOWER,
    RANGE_UPPER,
    degrees_to_joints,
    joints_to_degrees,
    joints_to_normalised,
    normalised_to_joints,
    opening_to_percent,
    percent_to_opening,
)


def random_joints() -> np.ndarray:
    return np.random.default_rng(0).uniform(SO101.joint_lower, SO101.joint_upper, (7, 3, SO101.dof))


def test_degrees_and_back_is_the_identity() -> None:
    joints = random_joints()
    np.testing.assert_allclose(degrees_to_joints(joints_to_degrees(joints)), joints, atol=1e-15)
    assert joints_to_degrees(np.pi / 2) == 90.0


def test_normalised_and_back_is_the_identity_within_the_limits() -> None:
    joints = random_joints()
    np.testing.assert_allclose(normalised_to_joints(joints_to_normalised(joints)), joints, atol=1e-14)


def test_the_ends_of_a_range_are_a_hundred_and_its_middle_is_zero() -> None:
    np.testing.assert_array_equal(joints_to_normalised(RANGE_LOWER), np.full(5, -100.0))
    np.testing.assert_array_equal(joints_to_normalised(RANGE_UPPER), np.full(5, 100.0))
    np.testing.assert_allclose(joints_to_normalised(np.zeros(5)), np.zeros(5), atol=1e-12)


def test_a_half_turn_of_the_wrist_roll_is_a_hundred() -> None:
    assert normalised_to_joints([0.0, 0.0, 0.0, 0.0, 100.0])[4] == pytest.approx(np.pi)


def test_what_is_outside_of_a_range_is_cut_to_it() -> None:
    np.testing.assert_array_equal(joints_to_normalised(np.full(5, 9.0)), np.full(5, 100.0))
    np.testing.assert_allclose(normalised_to_joints(np.full(5, -180.0)), RANGE_LOWER, atol=1e-15)


def test_ones_own_calibration_takes_the_place_of_the_limits() -> None:
    lower, upper = np.full(5, -1.0), np.full(5, 3.0)
    np.testing.assert_allclose(joints_to_normalised(np.full(5, 1.0), lower, upper), np.zeros(5), atol=1e-12)
    joints = np.linspace(-1.0, 3.0, 5)
    np.testing.assert_allclose(normalised_to_joints(joints_to_normalised(joints, lower, upper), lower, upper), joints)


def test_an_empty_range_is_refused() -> None:
    with pytest.raises(InvalidSetup, match="upper end"):
        joints_to_normalised(np.zeros(5), np.zeros(5), np.zeros(5))


def test_the_gripper_is_closed_at_zero_and_open_at_a_hundred() -> None:
    np.testing.assert_array_equal(opening_to_percent([0.0, 0.25, 1.0, 1.5]), [0.0, 25.0, 100.0, 100.0])
    openings = np.linspace(0.0, 1.0, 5)
    np.testing.assert_allclose(percent_to_opening(opening_to_percent(openings)), openings)
