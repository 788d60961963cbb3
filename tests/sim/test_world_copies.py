"""Which copies a call is for."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.sim.world import World


@pytest.fixture
def world(cart: mujoco.MjModel) -> World:
    """Three copies of the cart."""
    return World(cart, frequency=50.0, copies=3, threads=2)


@pytest.mark.parametrize("chosen", [[2, 0], (2, 0), np.array([2, 0], np.int64), np.array([0, 2], np.uint8)])
def test_copies_may_come_in_any_order_and_type_of_whole_numbers(world: World, chosen: Any) -> None:
    world.advance()
    world.advance(chosen)
    np.testing.assert_array_equal(world.core.steps, [2, 1, 2])
    world.refresh(chosen)
    world.update_constants(chosen)
    world.reset(chosen)
    np.testing.assert_array_equal(world.core.steps, [0, 1, 0])


@pytest.mark.parametrize("none", [[], (), np.array([]), np.array([], np.int32), np.zeros(0, np.bool_)])
def test_no_copies_are_none_and_not_all(world: World, none: Any) -> None:
    world.advance()
    for call in (world.advance, world.reset, world.refresh, world.update_constants):
        call(none)
    saved = world.save(none)
    assert saved.shape == (0, world.core.save_size)
    world.load(saved, none)
    np.testing.assert_array_equal(world.core.steps, [1, 1, 1])


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (np.array([2, 2], np.int32), "copy 2 is named more than once"),
        (np.array([1, 0, 1], np.int32), "copy 1 is named more than once"),
        (np.array([3], np.int32), "no copy 3"),
        ([-1], "no copy -1"),
        ([2**32 + 1], "no copy 4294967297"),
        ([2**64 - 1], "no copy 18446744073709551615"),
        (np.array([False, False, True]), "numpy.flatnonzero"),
        ([0.9, 1.9], "float64"),
        (["0"], "<U1"),
        ([[0], [1]], r"shape \(2, 1\)"),
        (1, r"shape \(\)"),
    ],
)
def test_what_does_not_name_copies_is_refused_and_changes_nothing(world: World, wrong: Any, text: str) -> None:
    world.advance()
    for call in (world.advance, world.reset, world.refresh, world.update_constants):
        with pytest.raises(InvalidSetup, match=text):
            call(wrong)
    np.testing.assert_array_equal(world.core.steps, [1, 1, 1])


def test_a_world_of_one_has_one_copy_to_name(cart: mujoco.MjModel) -> None:
    world = World(cart)
    world.advance([0])
    world.advance([])
    world.load(world.save([]), [])
    assert world.core.steps[0] == 1
    for wrong in ([1], [0, 0], [True]):
        with pytest.raises(InvalidSetup):
            world.advance(wrong)
