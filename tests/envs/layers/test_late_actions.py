"""Actions that miss their step are sent with the next one, and nothing above notices."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs.episode_random import EpisodeRandom
from rcs.envs.layers import LateActions
from rcs.sim.randomisation import Randomisation


def run(layer: LateActions, actions: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Send actions (steps, *leading, 1); return what was sent, and which were late."""
    layer.reset({"joints": start})
    sent, late = [], []
    for action in actions:
        mapped = layer.map_action({"joints": action})
        above = layer.map_executed(mapped)
        np.testing.assert_array_equal(above["joints"], action)
        sent.append(mapped["joints"])
        late.append(layer.info()["is_late"])
    return np.array(sent), np.array(late)


def test_a_late_step_sends_the_action_before_once_more_and_others_their_own() -> None:
    layer = LateActions(0.3)
    layer.begin(EpisodeRandom(3, 0))
    actions = np.arange(1.0, 201.0)[:, None]
    sent, late = run(layer, actions, np.zeros(1))
    before = np.concatenate([np.zeros((1, 1)), actions[:-1]])
    np.testing.assert_array_equal(sent, np.where(late[:, None], before, actions))
    assert 0.2 < late.mean() < 0.4


def test_the_same_episode_is_late_in_the_same_steps_alone_and_among_copies() -> None:
    actions = np.random.default_rng(0).normal(size=(50, 4, 1))
    many = LateActions(0.2, (4,))
    many.begin(EpisodeRandom(np.arange(4), np.zeros(4)))
    sent, late = run(many, actions, np.zeros((4, 1)))
    for copy in range(4):
        one = LateActions(0.2)
        one.begin(EpisodeRandom(copy, 0))
        alone, own = run(one, actions[:, copy], np.zeros(1))
        np.testing.assert_array_equal(alone, sent[:, copy])
        np.testing.assert_array_equal(own, late[:, copy])
    assert len({row.tobytes() for row in late.T}) == 4


def test_a_target_that_something_else_has_set_is_where_the_layer_goes_on() -> None:
    layer = LateActions(0.5)
    layer.begin(EpisodeRandom(0, 0))
    layer.reset({"joints": np.zeros(1)})
    layer.map_action({"joints": np.ones(1)})
    held = {"joints": np.full(1, 7.0)}
    np.testing.assert_array_equal(layer.map_executed(held)["joints"], [7.0])
    assert not layer.info()["is_late"]


def gripping(layer: LateActions, gripper: float) -> dict[str, np.ndarray]:
    """Have an action sent that is not late, with the fingers measured at 0.3 before, and return it."""
    layer.reset({"joints": np.zeros(1), "gripper": np.full(1, 0.3, np.float32)})
    layer.share = 0.0
    action = {"joints": np.ones(1), "gripper": np.full(1, gripper, np.float32)}
    layer.map_executed(layer.map_action(action))
    return action


OPENING = {"joints": np.full(1, 2.0), "gripper": np.ones(1, np.float32)}
HELD = {"joints": np.full(1, 7.0), "gripper": np.full(1, 0.3, np.float32)}
"""Where a robot is measured that holds something with a gripper that was told to close."""


def test_after_a_hold_a_late_action_does_not_loosen_the_grip() -> None:
    layer = LateActions(0.0)
    gripping(layer, 0.0)
    layer.rebase(HELD)
    layer.share = 1.0
    late = layer.map_action(OPENING)
    np.testing.assert_array_equal(late["joints"], HELD["joints"])
    np.testing.assert_array_equal(late["gripper"], [0.0])
    assert late["gripper"].dtype == np.float32


def test_after_a_refusal_a_late_action_does_not_loosen_the_grip() -> None:
    layer = LateActions(0.0)
    gripping(layer, 0.0)
    layer.map_action(OPENING)
    np.testing.assert_array_equal(layer.map_executed(HELD)["gripper"], HELD["gripper"])  # as layers above see it
    layer.rebase(HELD)
    layer.share = 1.0
    late = layer.map_action(OPENING)
    np.testing.assert_array_equal(late["joints"], HELD["joints"])
    np.testing.assert_array_equal(late["gripper"], [0.0])


def test_a_gripper_that_closes_while_the_way_of_the_arm_is_cut_goes_on_to_close() -> None:
    layer = LateActions(0.0)
    gripping(layer, 1.0)
    asked = {"joints": np.full(1, 2.0), "gripper": np.zeros(1, np.float32)}
    layer.map_action(asked)
    layer.map_executed({**asked, "joints": np.full(1, 1.5)})
    layer.share = 1.0
    late = layer.map_action(OPENING)
    np.testing.assert_array_equal(late["joints"], [1.5])
    np.testing.assert_array_equal(late["gripper"], [0.0])


def test_relative_actions_add_up_although_some_are_late_and_the_executed_action_says_what_was_sent() -> None:
    env: Any = rcs.make("Free", randomisation=Randomisation.off(late_actions=0.3))
    observation, _ = env.reset(seed=1)
    start, lates = observation["joints"].copy(), 0
    last = start
    for k in range(1, 21):
        *_, info = env.step({"joints": np.full(7, 0.002), "gripper": np.ones(1, np.float32)})
        np.testing.assert_allclose(info["target"]["joints"], start + 0.002 * k, atol=1e-12)
        executed = env.stack.executed["joints"]
        np.testing.assert_allclose(executed, last if info["is_late"] else info["target"]["joints"], atol=1e-12)
        last = info["target"]["joints"]
        lates += info["is_late"]
    assert 1 <= lates <= 12
    assert "LateActions" in str(env)


def test_synchronous_steps_are_never_late() -> None:
    env: Any = rcs.make("Free", stepping="sync", randomisation=Randomisation.off(late_actions=0.3))
    assert "LateActions" not in str(env)


def test_an_action_before_the_first_reset_is_a_mistake_of_the_caller() -> None:
    with pytest.raises(RuntimeError, match="before map_action"):
        LateActions(0.1).map_executed({})
