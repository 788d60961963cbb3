from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

import rcs
from rcs.envs.layers import DisturbActions
from rcs.errors import InvalidSetup
from tests.envs.notebook import Notebook

OPTIONS: Any = {"task": "Free", "control": "joints", "frequency": 10.0, "layers": [DisturbActions]}
OPEN = np.ones(1, np.float32)


def ways(env: Any, seed: int, steps: int = 10) -> Any:
    """Return the joints of an episode in which the agent stays, (steps, 7)."""
    env.reset(seed=seed)
    return np.array([env.step({"joints": np.zeros(7), "gripper": OPEN})[0]["joints"] for _ in range(steps)])


def test_the_arm_does_other_than_it_is_told_and_the_same_with_the_same_seed() -> None:
    options = {**OPTIONS, "task": "PickCuboid", "observe": ("privileged",)}
    env = rcs.make(**options)
    first, other, again = ways(env, 0), ways(env, 1), ways(env, 0)
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - first[0]).max() > 0.02
    assert np.abs(first - other).max() > 0.01


def test_noise_has_no_direction_and_its_size() -> None:
    layer = DisturbActions()
    bound = np.full(7, 0.2)
    layer.action_spaces({"joints": spaces.Box(-bound, bound, dtype=np.float64)})
    joints = np.random.default_rng(0).normal(size=(400, 7))
    layer.reset({"joints": joints})
    drawn = []
    for _ in range(100):
        drawn.append(layer.map_action({"joints": np.zeros((400, 7))})["joints"])
        layer.map_executed({})
    noise = np.array(drawn[20:])
    assert abs(noise.mean()) < 1e-3
    assert 0.012 < noise.std() < 0.024  # 0.12 of 0.2 where it comes, which is in 0.6 of the stretches
    assert np.abs(np.corrcoef(noise.reshape(-1, 7).T) - np.eye(7)).max() < 0.05


def test_copies_are_disturbed_like_single_environments() -> None:
    options = {**OPTIONS, "task": "PickCuboid", "observe": ("privileged",)}
    copies: Any = rcs.make_vec(copies=3, **options)
    single = rcs.make(**options)
    copies.reset(seed=[5, 6, 7])
    action = {"joints": np.zeros((3, 7)), "gripper": np.ones((3, 1), np.float32)}
    many = np.array([copies.step(action)[0]["joints"] for _ in range(10)])
    for copy, seed in enumerate((5, 6, 7)):
        np.testing.assert_array_equal(many[:, copy], ways(single, seed))


def test_what_is_recorded_as_the_action_is_what_the_agent_wanted() -> None:
    env, notebook = rcs.make(**OPTIONS), Notebook()
    env.add_observer(notebook)
    env.reset(seed=0)
    for _ in range(9):
        env.step({"joints": np.full(7, 0.01), "gripper": OPEN})
    steps: Any = notebook.seen[1:]
    wanted = np.array([step.action["joints"] for step in steps])
    done = np.array([step.executed["joints"] for step in steps])
    np.testing.assert_array_equal(wanted, 0.01)
    assert np.abs(np.diff(done, axis=0) - 0.01).max() > 0.005


def test_actions_that_are_not_relative_to_the_last_step_are_refused() -> None:
    for relative in ("absolute", "origin"):
        for robot in ("fr3", "ur5e"):  # the range of the latter's joints is even
            with pytest.raises(InvalidSetup, match="give relative='last_step'"):
                rcs.make(**{**OPTIONS, "robot": robot, "relative": relative})
    with pytest.raises(InvalidSetup, match="DisturbActions adds noise to joints"):
        rcs.make(**{**OPTIONS, "control": "tquat"})
