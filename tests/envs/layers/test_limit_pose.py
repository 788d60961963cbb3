from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rcs.envs.layers import LimitPose
from rcs.envs.spaces import TQUAT
from rcs.errors import InvalidAction
from rcs.spatial import distance, xyzrpy_to_tquat

FREQUENCY = 20.0
SPEEDS = np.array([0.5, 1.0])
STEP = SPEEDS / FREQUENCY
LEAD = SPEEDS * (0.5 + 1 / FREQUENCY)
SOME = arrays(np.float64, (3, 6), elements=st.floats(-1.0, 1.0)).map(xyzrpy_to_tquat)
ROUNDING = 1e-6


def layer(start: Any) -> LimitPose:
    made = LimitPose(*SPEEDS, frequency=FREQUENCY)
    made.reset({TQUAT: np.asarray(start)})
    return made


def execute(limit: LimitPose, asked: Any) -> Any:
    """Have a target mapped, and taken by the arm; return it."""
    return limit.map_executed(limit.map_action({TQUAT: asked}))[TQUAT]


@settings(max_examples=100, deadline=None)
@given(start=SOME, measured=SOME, asked=SOME)
def test_a_target_stays_within_the_lead_of_the_measured_pose_and_goes_by_a_step(
    start: Any, measured: Any, asked: Any
) -> None:
    limit = layer(start)
    limit.map_observation({TQUAT: measured})
    target = execute(limit, asked)
    assert (distance(target, measured) <= LEAD + ROUNDING).all()
    is_asked = (distance(target, asked) <= ROUNDING).all(axis=-1)
    is_held = (distance(start, measured) > LEAD - STEP).any(axis=-1)
    is_near = (distance(target, start) <= STEP + ROUNDING).all(axis=-1)
    assert (is_asked | is_held | is_near).all()
    np.testing.assert_array_equal(limit.info()["is_limited"], ~is_asked)


@settings(max_examples=50, deadline=None)
@given(start=SOME, asked=SOME)
def test_rows_do_not_know_of_each_other(start: Any, asked: Any) -> None:
    targets = execute(layer(start), asked)
    for row in range(3):
        np.testing.assert_array_equal(execute(layer(start[row]), asked[row]), targets[row])


def test_a_far_target_is_reached_while_the_arm_follows_and_no_farther_than_the_lead_while_it_does_not() -> None:
    start, goal = xyzrpy_to_tquat([0.4, 0, 0.4, 3.0, 0, 0]), xyzrpy_to_tquat([0.4, 0.5, 0.4, 3.0, 0, 1.0])
    follows, is_blocked = layer(start), layer(start)
    for _ in range(25):
        reached = execute(follows, goal)
        follows.map_observation({TQUAT: reached})
        kept = execute(is_blocked, goal)
    np.testing.assert_allclose(reached, goal, atol=1e-9)
    assert distance(kept, start) == pytest.approx(LEAD, rel=0.2)
    assert is_blocked.info()["is_limited"] and not follows.info()["is_limited"]


def test_an_arm_that_is_to_stop_does_so_at_once_however_far_its_target_is_ahead() -> None:
    start, goal = xyzrpy_to_tquat([0.4, 0, 0.4, 3.0, 0, 0]), xyzrpy_to_tquat([0.4, 0.5, 0.4, 3.0, 0, 0])
    limit = layer(start)
    for _ in range(10):
        execute(limit, goal)
    np.testing.assert_allclose(execute(limit, start), start)


def test_a_quaternion_without_a_direction_is_refused() -> None:
    with pytest.raises(InvalidAction, match="norm 0"):
        layer(np.eye(7)[6]).map_action({TQUAT: np.zeros(7)})
