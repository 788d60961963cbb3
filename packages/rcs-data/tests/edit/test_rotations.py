from __future__ import annotations

import numpy as np
import pytest
from rcs_data.edit.rotations import from_rotvec, from_rpy, multiply, normalized, to_rotvec, to_rpy


def same(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(abs(abs(a @ b) - 1) < 1e-12)


def test_there_and_back() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        rotation = normalized(rng.normal(size=4))
        assert same(from_rotvec(to_rotvec(rotation)), rotation)
        assert same(from_rpy(to_rpy(rotation)), rotation)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_at_a_quarter_turn_of_pitch_the_rotation_is_kept(pitch: float) -> None:
    rotation = from_rpy(np.array([0.4, pitch, 0.9]))
    assert to_rpy(rotation)[2] == 0.0
    assert same(from_rpy(to_rpy(rotation)), rotation)


def test_turns_about_one_axis_add_up() -> None:
    axis = normalized(np.array([0.3, -0.2, 0.9]))
    both = multiply(from_rotvec(0.7 * axis), from_rotvec(0.4 * axis))
    np.testing.assert_allclose(to_rotvec(both), 1.1 * axis, atol=1e-12)


def test_no_turn_is_no_rotation() -> None:
    np.testing.assert_array_equal(to_rotvec(from_rotvec(np.zeros(3))), np.zeros(3))
