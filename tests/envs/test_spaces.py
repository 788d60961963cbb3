from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis.extra.numpy import arrays

from rcs.envs.spaces import ActionCheck, joints_space, normalised_space, tquat_space, xyzrpy_space
from rcs.errors import InvalidAction

BOXES = {"joints": joints_space([-1.0, -2.0], [1.0, 2.0]), "gripper": normalised_space(1)}
GOOD: dict[str, Any] = {"joints": np.array([0.5, -1.5]), "gripper": np.ones(1, np.float32)}


@pytest.mark.parametrize(
    ("action", "texts"),
    [
        (None, ["mapping", "'joints' (2,) float64", "'gripper' (1,) float32", "got NoneType"]),
        (np.zeros(3), ["got ndarray"]),
        ({}, ["missing ['joints', 'gripper']"]),
        ({"joints": np.zeros(2)}, ["missing ['gripper']"]),
        ({**GOOD, "hand": np.zeros(2)}, ["unknown ['hand']"]),
        ({"joint": np.zeros(2), "gripper": np.zeros(1)}, ["missing ['joints']", "unknown ['joint']"]),
        ({**GOOD, "joints": np.zeros(3)}, ["'joints'", "(3,)", "valid is (2,)"]),
        ({**GOOD, "joints": np.zeros((1, 2))}, ["'joints'", "(1, 2)", "valid is (2,)"]),
        ({**GOOD, "joints": 0.0}, ["'joints'", "()", "valid is (2,)"]),
        ({**GOOD, "joints": ["a", "b"]}, ["'joints'", "dtype <U1", "valid is float64"]),
        ({**GOOD, "joints": [None, None]}, ["'joints'", "dtype object"]),
        ({**GOOD, "joints": np.zeros(2, np.bool_)}, ["'joints'", "dtype bool"]),
        ({**GOOD, "joints": np.zeros(2, np.complex128)}, ["'joints'", "dtype complex128"]),
        ({**GOOD, "joints": [[0.0], [0.0, 0.0]]}, ["'joints'", "not an array"]),
        ({**GOOD, "joints": [0.0, np.nan]}, ["'joints'[1] is nan", "valid is -2 to 2"]),
        ({**GOOD, "joints": [np.inf, 0.0]}, ["'joints'[0] is inf", "valid is -1 to 1"]),
        ({**GOOD, "joints": [0.0, -2.1]}, ["'joints'[1] is -2.1", "valid is -2 to 2", "Nothing was sent"]),
        ({**GOOD, "gripper": np.array([1.5], np.float32)}, ["'gripper'[0] is 1.5", "valid is 0 to 1"]),
        ({**GOOD, "gripper": np.array([np.nan])}, ["'gripper'[0] is nan"]),
    ],
)
def test_a_bad_action_is_refused_with_what_came_and_what_is_valid(action: Any, texts: list[str]) -> None:
    with pytest.raises(InvalidAction) as caught:
        ActionCheck(BOXES)(action)
    for text in texts:
        assert text in str(caught.value)


def test_in_a_batch_the_message_names_the_copy() -> None:
    batch = {"joints": np.zeros((3, 2)), "gripper": np.zeros((3, 1))}
    ActionCheck(BOXES, (3,))(batch)
    batch["joints"][2, 1] = np.nan
    with pytest.raises(InvalidAction, match=re.escape("'joints'[2, 1] is nan")):
        ActionCheck(BOXES, (3,))(batch)
    with pytest.raises(InvalidAction, match=re.escape("valid is (4, 2)")):
        ActionCheck(BOXES, (4,))(batch)


@settings(max_examples=200, deadline=None)
@given(joints=arrays(np.float64, 2), gripper=arrays(np.float32, 1))
def test_what_passes_is_inside_the_bounds_and_what_is_inside_passes(joints: Any, gripper: Any) -> None:
    action = {"joints": joints, "gripper": gripper}
    is_inside = all(np.isfinite(action[key]).all() and box.contains(action[key]) for key, box in BOXES.items())
    try:
        checked = ActionCheck(BOXES)(action)
    except InvalidAction:
        assert not is_inside
        return
    for key, box in BOXES.items():
        assert box.contains(checked[key])
        if is_inside:
            np.testing.assert_array_equal(checked[key], action[key])


@pytest.mark.parametrize(
    "joints",
    [[0, 1], (0.5, 1.5), np.array([0, 1], np.int8), np.array([0.5, 1.5], np.float32), np.array([1.5, 0.0, 0.5])[::-2]],
)
def test_numbers_of_any_kind_become_arrays_of_the_right_dtype(joints: Any) -> None:
    checked = ActionCheck(BOXES)({"joints": joints, "gripper": [1]})
    np.testing.assert_array_equal(checked["joints"], np.asarray(joints, np.float64))
    assert checked["joints"].dtype == np.float64
    assert checked["gripper"].dtype == np.float32


def test_a_bound_that_went_through_float32_is_still_inside() -> None:
    boxes = {"joints": joints_space([-2.7437, -2.9007], [2.7437, 2.9007])}
    rounded = np.array([2.7437, 2.9007], np.float32)
    assert (rounded > boxes["joints"].high).any()
    checked = ActionCheck(boxes)({"joints": rounded})
    assert (checked["joints"] <= boxes["joints"].high).all()


def test_checked_arrays_are_fresh() -> None:
    action = {key: value.copy() for key, value in GOOD.items()}
    checked = ActionCheck(BOXES)(action)
    for key in BOXES:
        assert not np.shares_memory(checked[key], action[key])
        np.testing.assert_array_equal(action[key], GOOD[key])


@pytest.mark.parametrize("box", [tquat_space(), xyzrpy_space(), normalised_space(3)])
def test_every_bound_is_an_action(box: spaces.Box) -> None:
    for bound in (box.low, box.high):
        np.testing.assert_array_equal(ActionCheck({"key": box})({"key": bound})["key"], bound)
