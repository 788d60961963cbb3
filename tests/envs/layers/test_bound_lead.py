from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs.layers import BoundLead
from rcs.errors import InvalidSetup

OPEN = np.ones(1, np.float32)
OPTIONS: dict[str, Any] = {"control": "xyzrpy", "frequency": 10.0, "collision_reaction": False, "physics_step": 0.004}


def make(robot: str, layers: list[Any]) -> Any:
    return rcs.make("PickCuboid", robot=robot, layers=layers, max_episode_steps=None, **OPTIONS)


def heights(env: Any, direction: float, steps: int) -> list[float]:
    """Move up or down as fast as may be, and return how high the TCP was after each step."""
    action = np.zeros(6)
    action[2] = direction * env.action_space["xyzrpy"].high[2]
    return [float(env.step({"xyzrpy": action, "gripper": OPEN})[0]["tquat"][2]) for _ in range(steps)]


@pytest.mark.parametrize("robot", ["fr3", "so101"])
def test_an_arm_that_pressed_on_the_table_comes_up_at_once(robot: str) -> None:
    env = make(robot, [BoundLead])
    env.reset(seed=0)
    low = heights(env, -1.0, 40)[-1]
    assert heights(env, 1.0, 5)[-1] > low + 0.02


@pytest.mark.parametrize("robot", ["fr3", "so101"])
def test_a_single_action_up_frees_an_arm_that_pressed_on_the_table(robot: str) -> None:
    env = make(robot, [BoundLead])
    env.reset(seed=0)
    low = heights(env, -1.0, 40)[-1]
    up = heights(env, 0.5, 1)
    assert max(up + heights(env, 0.0, 3)) > low + 0.008


def test_without_it_the_target_is_deep_in_the_table() -> None:
    without = make("fr3", [])
    without.reset(seed=0)
    low = heights(without, -1.0, 40)[-1]
    assert heights(without, 1.0, 5)[-1] < low + 0.02


@pytest.mark.parametrize("robot", ["fr3", "so101"])
def test_a_free_arm_that_turns_all_the_time_is_nearly_as_fast_as_without(robot: str) -> None:
    speeds = []
    for layers in ([BoundLead], []):
        env = make(robot, layers)
        env.reset(seed=0)
        speeds.append(np.abs(np.diff([*heights(env, 1.0, 3), *heights(env, -1.0, 3), *heights(env, 1.0, 3)])).max())
    assert speeds[0] > 0.5 * speeds[1]


def test_copies_act_like_single_environments() -> None:
    rng = np.random.default_rng(0)
    options: Any = {"robot": "ur5e", "layers": [BoundLead], **OPTIONS}
    copies: Any = rcs.make_vec("PickCuboid", copies=3, **options)
    single = rcs.make("PickCuboid", **options)
    copies.reset(seed=4)
    single.reset(seed=5)
    opening = np.ones((3, 1), np.float32)
    for _ in range(20):
        action = rng.uniform(-1, 0.2, (3, 6)) * copies.single_action_space["xyzrpy"].high
        many = copies.step({"xyzrpy": action, "gripper": opening})[0]
        one = single.step({"xyzrpy": action[1], "gripper": opening[1]})[0]
        np.testing.assert_array_equal(many["tquat"][1], one["tquat"])


@pytest.mark.parametrize(
    "options", [{"control": "joints"}, *({"control": "xyzrpy", "relative": to} for to in ("absolute", "origin"))]
)
def test_it_says_which_control_it_needs(options: Any) -> None:
    with pytest.raises(InvalidSetup, match="needs control='xyzrpy' and relative='last_step'"):
        rcs.make("Free", layers=[BoundLead], **options)
