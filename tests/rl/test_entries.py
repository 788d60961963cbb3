from __future__ import annotations

import functools
import json
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

import rcs
from rcs.envs.env import Env
from rcs.errors import InvalidSetup
from rcs.rl import Flat, FlatLayout, Selection


@functools.cache
def pick() -> tuple[Env, Flat]:
    env = rcs.make(observe=("privileged", "contacts"))
    return env, Flat(env)


def require_same_bits(a: dict[str, Any], b: dict[str, Any]) -> None:
    assert a.keys() == b.keys()
    for key in a:
        np.testing.assert_array_equal(a[key], b[key])
        assert a[key].dtype == b[key].dtype


def test_keys_choose_what_is_observed() -> None:
    env, whole = pick()
    observation, _ = env.reset(seed=0)
    flat = Flat(env, Selection(keys=("joints", "privileged"), features=()))
    back = flat.observation_dict(flat.observation(observation))
    assert back.keys() == {"joints", "privileged"}
    assert back["privileged"]["cuboid"].keys() == {"tquat", "velocity"}
    redundant = Flat(env, Selection(keys=("xyzrpy",), features=()))
    np.testing.assert_allclose(
        redundant.observation_dict(redundant.observation(observation))["xyzrpy"], observation["xyzrpy"], atol=1e-6
    )
    assert flat.layout.state_size < whole.layout.state_size
    with pytest.raises(InvalidSetup, match="no key 'joint' of numbers in the observation; valid: finger_contacts"):
        Flat(env, Selection(keys=("joint",)))
    with pytest.raises(InvalidSetup, match=r"no cameras \['wrist'\]; valid: none"):
        Flat(env, Selection(cameras=("wrist",)))
    with pytest.raises(InvalidSetup, match="A layout was given and also a selection"):
        Flat(whole.layout, Selection())


def test_numbers_of_an_action_that_are_not_selected_stay_in_the_middle() -> None:
    env = rcs.make("Free", robot="ur5e", control="xyzrpy")
    whole = Flat(env)
    flat = Flat(env, Selection(actions=("xyzrpy[5]", "gripper", "xyzrpy[0:3]")))
    assert flat.action_space.shape == (5,)
    vectors = np.random.default_rng(0).uniform(-1, 1, (4, 5)).astype(np.float32)
    every = np.zeros((4, 7))  # the gripper first, then x, y, z, roll, pitch, yaw
    every[:, [6, 0, 1, 2, 3]] = vectors
    require_same_bits(flat.action(vectors), whole.action(every))
    np.testing.assert_allclose(flat.action_vector(whole.action(every)), vectors, atol=1e-6)
    stored = Flat(FlatLayout.from_json(json.loads(json.dumps(flat.layout.to_json()))))
    require_same_bits(stored.action(vectors[1]), flat.action(vectors[1]))
    for actions, message in (
        (("xyzrpy",), "actions has nothing of gripper"),
        (("xyzrpy", "gripper", "xyzrpy[2]"), r"'xyzrpy\[2\]', numbers of which it has before"),
        (("xyzrpy[4:7]", "gripper"), r"'xyzrpy\[4:7\]'; the key has the numbers 0 to 5"),
        (("xyzrpy[3:3]", "gripper"), "the key has the numbers 0 to 5"),
        (("yaw", "gripper"), r"actions has 'yaw'; valid are gripper, xyzrpy, or numbers of them"),
        (("xyzrpy[", "gripper"), r"actions has 'xyzrpy\['; valid are"),
    ):
        with pytest.raises(InvalidSetup, match=message):
            Flat(env, Selection(actions=actions))


def test_spaces_alone_make_maps_with_general_scales() -> None:
    env, known = pick()
    flat = Flat.from_spaces(env.action_space, env.observation_space)
    observation, _ = env.reset(seed=0)
    assert flat.layout.state_size == known.layout.state_size
    np.testing.assert_allclose(
        flat.observation_dict(flat.observation(observation))["joints"], observation["joints"], atol=1e-6
    )
    two = rcs.make("LiftBar", robot="dual_fr3", observe=("privileged",))
    flat = Flat.from_spaces(two.action_space, two.observation_space)
    assert {one.kind for one in flat.layout.state} == {"value", "turn"}  # where the bases stand is not known


def test_whole_numbers_come_back_as_they_were() -> None:
    flat = Flat.from_spaces(
        spaces.Dict(a=spaces.Box(0, 1, (1,))), spaces.Dict(levels=spaces.Box(0, 255, (256,), np.uint8))
    )
    levels = np.arange(256, dtype=np.uint8)
    vector = flat.observation({"levels": levels})
    for rounding in (-1e-4, 0.0, 1e-4):
        back = flat.observation_dict(vector + rounding)["levels"]
        np.testing.assert_array_equal(back, levels)
        assert back.dtype == np.uint8


def test_spaces_without_numbers_or_bounds_are_refused() -> None:
    box = spaces.Box(-1, 1, (2,))
    with pytest.raises(InvalidSetup, match="'mode' has the space Discrete"):
        Flat.from_spaces(spaces.Dict(mode=spaces.Discrete(3)), spaces.Dict(a=box))
    with pytest.raises(InvalidSetup, match="'force' has no finite bounds"):
        Flat.from_spaces(spaces.Dict(force=spaces.Box(-np.inf, np.inf, (1,))), spaces.Dict(a=box))
    with pytest.raises(InvalidSetup, match="Nothing is left to observe"):
        Flat.from_spaces(spaces.Dict(a=box), spaces.Dict())
    unbounded = spaces.Dict(a=spaces.Box(np.array([-np.inf, 0]), np.array([np.inf, 4]), dtype=np.float64), b=box)
    flat = Flat.from_spaces(spaces.Dict(a=box), unbounded)
    np.testing.assert_array_equal(flat.observation({"a": np.array([30.0, 4.0]), "b": np.zeros(2)}), [30, 1, 0, 0])
