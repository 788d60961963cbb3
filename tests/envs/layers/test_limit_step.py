from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from rcs.envs.layers import LimitStep
from rcs.envs.spaces import JOINTS

STEP = np.array([0.1, 0.2])
LEAD = 0.6
SOME = arrays(np.float64, (3, 2), elements=st.floats(-3.0, 3.0))


def layer(start: Any) -> LimitStep:
    made = LimitStep(STEP, LEAD)
    made.reset({JOINTS: np.asarray(start)})
    return made


def execute(limit: LimitStep, asked: Any) -> Any:
    """Have a target mapped, and taken by the arm; return it."""
    return limit.map_executed(limit.map_action({JOINTS: asked}))[JOINTS]


@settings(max_examples=100, deadline=None)
@given(starts=SOME, measured=SOME, asked=SOME)
def test_a_target_stays_within_a_step_of_the_last_and_within_the_lead_of_the_measured(
    starts: Any, measured: Any, asked: Any
) -> None:
    limit = layer(starts)
    limit.map_observation({JOINTS: measured})
    target = execute(limit, asked)
    rounding = 1e-9
    # What brings it back towards the measured joint is not bounded.
    back = np.clip(asked, np.minimum(starts, measured), np.maximum(starts, measured))
    is_near = np.minimum(np.abs(target - starts), np.abs(target - back)) <= STEP + rounding
    held = np.clip(starts, measured - LEAD, measured + LEAD)
    assert (is_near | (np.abs(target - held) <= STEP + rounding)).all()
    # Where the arm was pushed farther than a step can make up for, the target goes towards it by a whole step.
    is_pushed = np.abs(measured - starts) > LEAD + STEP
    assert (np.abs(target - measured) <= LEAD + rounding)[~is_pushed].all()
    assert (np.abs(target - measured) <= np.abs(starts - measured))[is_pushed].all()
    is_cut = np.abs(target - asked).max(axis=-1) > rounding
    np.testing.assert_array_equal(limit.info()["is_limited"], is_cut)


@settings(max_examples=50, deadline=None)
@given(starts=SOME, measured=SOME, asked=SOME)
def test_rows_do_not_know_of_each_other(starts: Any, measured: Any, asked: Any) -> None:
    batch = layer(starts)
    batch.map_observation({JOINTS: measured})
    targets = execute(batch, asked)
    for row in range(3):
        single = layer(starts[row])
        single.map_observation({JOINTS: measured[row]})
        np.testing.assert_array_equal(execute(single, asked[row]), targets[row])
        assert single.info()["is_limited"] == batch.info()["is_limited"][row]


@settings(max_examples=100, deadline=None)
@given(starts=SOME, asked=SOME)
def test_all_joints_of_a_row_go_the_same_share_of_the_way(starts: Any, asked: Any) -> None:
    way = asked - starts
    share = np.minimum(1.0, (STEP / np.maximum(np.abs(way), 1e-300)).min(axis=-1, keepdims=True))
    np.testing.assert_allclose(execute(layer(starts), asked), starts + share * way, atol=2e-9)


def test_a_joint_at_the_end_of_its_lead_stops_all_until_it_goes_back() -> None:
    limit = layer([0.6, 0.0])
    limit.map_observation({JOINTS: np.zeros(2)})
    np.testing.assert_array_equal(execute(limit, np.array([0.7, 0.1])), [0.6, 0.0])
    assert limit.info()["is_limited"]
    np.testing.assert_array_equal(execute(limit, np.array([0.55, 0.1])), [0.55, 0.1])


def test_a_target_inside_the_bounds_passes_as_it_is() -> None:
    limit = layer([0.0, 0.0])
    action = {JOINTS: np.array([0.05, -0.2]), "gripper": np.ones(1)}
    assert limit.map_action(action) is action
    assert not limit.info()["is_limited"]


def test_a_row_that_counts_as_not_cut_keeps_its_bits_also_when_another_is_cut() -> None:
    limit = layer(np.zeros((2, 2)))
    asked = np.array([STEP + 5e-10, STEP + 1.0])
    target = execute(limit, asked)
    np.testing.assert_array_equal(target[0], asked[0])
    np.testing.assert_allclose(target[1], [0.1, 0.1 * 1.2 / 1.1])
    np.testing.assert_array_equal(limit.info()["is_limited"], [False, True])


def test_the_argument_stays_as_it_is() -> None:
    limit = layer([0.0, 0.0])
    action = {JOINTS: np.array([5.0, 5.0])}
    assert limit.map_action(action) is not action
    np.testing.assert_array_equal(action[JOINTS], [5.0, 5.0])


def test_a_reset_of_some_copies_leaves_the_others() -> None:
    limit = layer(np.zeros((3, 2)))
    execute(limit, np.full((3, 2), 9.0))
    limit.reset({JOINTS: np.full((3, 2), 1.0)}, np.array([1], np.int32))
    np.testing.assert_array_equal(limit.info()["is_limited"], [True, False, True])
    target = limit.map_action({JOINTS: np.full((3, 2), 1.0)})[JOINTS]
    # The other two, 0.9 rad from where they are measured now, go back towards that by a step of each joint.
    np.testing.assert_allclose(target, [[0.2, 0.3], [1.0, 1.0], [0.2, 0.3]])


def test_an_action_that_is_mapped_and_not_executed_leaves_no_trace() -> None:
    limit = layer([0.0, 0.0])
    for _ in range(8):
        limit.map_action({JOINTS: np.full(2, 9.0)})
    assert not limit.info()["is_limited"]
    np.testing.assert_allclose(execute(limit, np.full(2, 9.0)), [0.1, 0.1])


def test_after_a_rebase_the_next_target_is_bounded_against_the_measured_joints() -> None:
    limit = layer([0.0, 0.0])
    limit.rebase({JOINTS: np.array([1.0, -1.0])})
    np.testing.assert_allclose(execute(limit, np.full(2, 9.0)), [1.1, -1.0 + 10 * 0.1 / 8])


def test_without_a_reset_there_is_nothing_to_limit_against() -> None:
    with pytest.raises(RuntimeError, match="before reset"):
        LimitStep(STEP, LEAD).map_action({JOINTS: np.zeros(2)})
