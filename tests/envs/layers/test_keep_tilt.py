from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs.layers import KeepTilt
from rcs.errors import InvalidSetup
from rcs.spatial import tquat_to_matrix

OPEN = np.ones(1, np.float32)


def play(env: Any, action: Any, steps: int) -> Any:
    """Repeat an action, and return the last observation."""
    return [env.step({"xyzyaw": np.asarray(action, np.float64), "gripper": OPEN})[0] for _ in range(steps)][-1]


def tilt(tquat: Any) -> Any:
    """Return the angle between the tool and the vertical [rad]."""
    return np.arccos(np.clip(-tquat_to_matrix(tquat)[..., 2, 2], -1.0, 1.0))


def make(robot: str, **options: Any) -> Any:
    return rcs.make(
        "Free", robot=robot, control="xyzrpy", frequency=10.0, layers=[KeepTilt], collision_reaction=False, **options
    )


def test_an_action_moves_the_tcp_and_turns_it_about_the_vertical() -> None:
    env = make("fr3")
    first = env.reset(seed=0)[0]["tquat"]
    assert env.action_space["xyzyaw"].shape == (4,)
    play(env, [0.01, -0.02, 0.015, 0.1], 5)
    observation = play(env, np.zeros(4), 8)
    np.testing.assert_allclose(observation["tquat"][:3] - first[:3], [0.05, -0.10, 0.075], atol=2e-3)
    start, end = tquat_to_matrix(first)[:3, :3], tquat_to_matrix(observation["tquat"])[:3, :3]
    c, s = np.cos(0.5), np.sin(0.5)
    np.testing.assert_allclose(end @ start.T, [[c, -s, 0], [s, c, 0], [0, 0, 1]], atol=5e-3)


def test_a_tool_that_leaned_at_the_edge_of_the_reach_is_upright_again_when_it_comes_back() -> None:
    env = make("ur5e")
    env.reset(seed=0)
    leaned = 0.0
    for direction in (1.0, -1.0):
        for _ in range(25):
            leaned = max(leaned, float(tilt(play(env, [0.03 * direction, 0.04 * direction, 0.0, 0.0], 1)["tquat"])))
    observation = play(env, np.zeros(4), 15)
    assert leaned > 0.1
    assert tilt(observation["tquat"]) < 0.02


def test_copies_act_like_single_environments() -> None:
    rng = np.random.default_rng(0)
    options: Any = {"robot": "ur5e", "control": "xyzrpy", "frequency": 10.0, "layers": [KeepTilt]}
    copies: Any = rcs.make_vec("Free", copies=3, **options)
    single = rcs.make("Free", **options)
    many, one = copies.reset(seed=4)[0], single.reset(seed=5)[0]
    for _ in range(20):
        action = rng.uniform(-1, 1, (3, 4)) * copies.single_action_space["xyzyaw"].high
        opening = np.ones((3, 1), np.float32)
        many = copies.step({"xyzyaw": action, "gripper": opening})[0]
        one = single.step({"xyzyaw": action[1], "gripper": opening[1]})[0]
        np.testing.assert_array_equal(many["tquat"][1], one["tquat"])


def test_an_arm_with_five_joints_reaches_the_place_and_points_down_where_it_can() -> None:
    env = make("so101")
    first = env.reset(seed=0)[0]["tquat"]
    play(env, [0.0, 0.0, -0.015, 0.0], 6)
    observation = play(env, np.zeros(4), 8)
    np.testing.assert_allclose(observation["tquat"][:3] - first[:3], [0.0, 0.0, -0.09], atol=3e-3)
    assert tilt(first) > 0.5
    assert tilt(observation["tquat"]) < 0.05


def test_an_arm_with_five_joints_does_not_lean_more_and_more() -> None:
    env = make("so101")
    env.reset(seed=0)
    play(env, [0.0, 0.0, -0.015, 0.0], 6)
    for _ in range(3):
        for direction in (1.0, -1.0):
            play(env, [-0.01 * direction, 0.015 * direction, 0.01 * direction, 0.05 * direction], 6)
    assert tilt(play(env, np.zeros(4), 8)["tquat"]) < 0.05


@pytest.mark.parametrize(
    "options", [{"control": "joints"}, *({"control": "xyzrpy", "relative": to} for to in ("absolute", "origin"))]
)
def test_it_says_which_control_it_needs(options: Any) -> None:
    with pytest.raises(InvalidSetup, match="needs control='xyzrpy' and relative='last_step'"):
        rcs.make("Free", layers=[KeepTilt], **options)
