"""Divergence: what is measured is what was put in, and the first row beyond a tolerance is found."""

from __future__ import annotations

import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.rollout.divergence import Divergence, Tolerance, Trace


def trace(rows: int, objects: int = 1) -> Trace:
    poses = np.zeros((rows, max(objects, 1), 7))
    poses[..., 6] = 1.0
    return Trace(joints=np.zeros((rows, 3)), tcps=poses[:, :1].copy(), objects=poses[:, :objects].copy())


def test_an_episode_does_not_diverge_from_itself() -> None:
    found = Divergence.between(trace(5), trace(5))
    assert found.first_beyond(Tolerance(max_joint_error=0.0, max_position_error=0.0)) is None
    assert found.summary()["joints"] == {"max": 0.0, "median": 0.0}


def test_each_error_is_measured_where_it_is() -> None:
    other = trace(6)
    other.joints[2, 1] = -0.3
    other.tcps[3, 0, 0] = 0.02
    other.objects[4, 0, 3:] = [0.0, 0.0, np.sin(0.1), np.cos(0.1)]
    found = Divergence.between(trace(6), other)
    np.testing.assert_allclose(found.joints, [0, 0, 0.3, 0, 0, 0])
    np.testing.assert_allclose(found.position, [0, 0, 0, 0.02, 0, 0])
    np.testing.assert_allclose(found.object_rotation, [0, 0, 0, 0, 0.2, 0], atol=1e-12)
    assert found.first_beyond(Tolerance()) == (2, "joints")
    assert found.first_beyond(Tolerance(max_joint_error=1.0)) == (3, "position")
    assert found.first_beyond(Tolerance(max_joint_error=1.0, max_position_error=1.0)) == (4, "object_rotation")


def test_episodes_of_different_length_are_compared_as_far_as_both_go() -> None:
    assert len(Divergence.between(trace(4), trace(7)).joints) == 4


def test_without_objects_their_errors_are_not_there() -> None:
    found = Divergence.between(trace(4, objects=0), trace(4, objects=0))
    assert found.summary()["object_position"] is None
    assert found.to_json()["object_rotation"] == []


@pytest.mark.parametrize("value", [-0.1, float("nan")])
def test_a_tolerance_that_is_none_is_refused(value: float) -> None:
    with pytest.raises(InvalidSetup, match="max_joint_error"):
        Tolerance(max_joint_error=value)
