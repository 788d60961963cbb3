"""A chain refuses layers that ask for keys that are not there, or return something else than their spaces say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

import rcs
from rcs.envs.layers import Layer
from rcs.errors import InvalidSetup


class WrongKey(Layer):
    """Asks for what is not there, in one of its methods."""

    def __init__(self, method: str) -> None:
        inherited = getattr(self, method)

        def ask(given: Any, *more: Any) -> Any:
            _ = given["griper"]
            return inherited(given, *more)

        setattr(self, method, ask)

    def __str__(self) -> str:
        return "WrongKey"


class Changed(Layer):
    """Returns an observation that its spaces do not tell of."""

    def __init__(self, observation: Any) -> None:
        self._observation = observation

    def map_observation(self, observation: dict[str, Any]) -> Any:
        return self._observation(observation)


class Short(Layer):
    """Gives the level below an action that is not its own."""

    def __init__(self, action: Any) -> None:
        self._action = action

    def map_action(self, action: dict[str, Any]) -> Any:
        return self._action(action)


class NoSpaces(Layer):
    """Forgets to return its spaces."""

    def observation_spaces(self, inner: Any) -> Any:
        return None


class Doubled(Layer):
    """Shows the joints twice, and says so."""

    def observation_spaces(self, inner: Any) -> dict[str, spaces.Space[Any]]:
        box = inner["joints"]
        return {**inner, "joints": spaces.Box(np.tile(box.low, 2), np.tile(box.high, 2), dtype=box.dtype)}

    def map_observation(self, observation: dict[str, Any]) -> dict[str, Any]:
        joints = np.concatenate([observation["joints"]] * 2, axis=-1)
        return {**observation, "joints": joints}


def action_of(env: Any) -> Any:
    return {key: np.zeros(box.shape, box.dtype) for key, box in env.action_space.spaces.items()}


@pytest.mark.parametrize("method", ["action_spaces", "observation_spaces"])
def test_a_layer_that_asks_for_a_key_that_is_not_there_is_named_when_it_is_assembled(method: str) -> None:
    with pytest.raises(InvalidSetup, match=r"The layer WrongKey needs the key 'griper'.*the keys are 'joints'"):
        rcs.make("Free", layers=[WrongKey(method)])


@pytest.mark.parametrize("method", ["reset", "map_observation", "map_action", "map_executed"])
def test_a_layer_that_asks_for_a_key_that_is_not_there_is_named_when_it_does(method: str) -> None:
    env = rcs.make("Free", layers=[WrongKey(method)])
    with env, pytest.raises(InvalidSetup, match=r"The layer WrongKey needs the key 'griper'.*the keys are .*'joints'"):
        run(env)


def run(env: Any) -> None:
    env.reset(seed=0)
    env.step(action_of(env))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda seen: {**seen, "joints": seen["joints"][..., :3]}, r"'joints' as \(3,\) float64; .*\(7,\) float64"),
        (lambda seen: {**seen, "joints": seen["joints"].astype("f4")}, r"'joints' as \(7,\) float32; .*\(7,\) float64"),
        (lambda seen: {**seen, "joints": 3}, r"'joints' as 3; .*\(7,\) float64"),
        (lambda seen: {"joints": seen["joints"]}, r"with the keys joints; its spaces have joints, "),
        (lambda seen: {**seen, "more": seen["joints"]}, r"with the keys .*, more; its spaces have"),
        (lambda seen: None, r"with the keys None; its spaces have"),
    ],
)
def test_a_layer_whose_observation_is_not_in_its_space_is_refused_at_the_first_reset(change: Any, words: str) -> None:
    env = rcs.make("Free", layers=[Changed(change)])
    with env, pytest.raises(InvalidSetup, match=r"The layer Changed gives the observation " + words):
        env.reset(seed=0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda action: {**action, "joints": action["joints"][..., :3]}, r"'joints' as \(3,\)"),
        (lambda action: {"joints": action["joints"]}, r"with the keys joints; its spaces have joints, gripper"),
        (lambda action: None, r"with the keys None"),
    ],
)
def test_a_layer_whose_action_is_not_in_the_space_below_is_refused_before_anything_moves(
    change: Any, words: str
) -> None:
    with rcs.make("Free", layers=[Short(change)]) as env:
        env.reset(seed=0)
        assert env.simulation is not None
        before = (env.simulation.world.qpos.copy(), env.simulation.world.time.copy())
        with pytest.raises(InvalidSetup, match=r"The layer Short gives the action " + words):
            env.step(action_of(env))
        np.testing.assert_equal((env.simulation.world.qpos, env.simulation.world.time), before)


def test_a_layer_that_returns_no_spaces_is_named() -> None:
    with pytest.raises(InvalidSetup, match=r"NoSpaces\.observation_spaces returned None; valid is a dictionary"):
        rcs.make("Free", layers=[NoSpaces()])


@pytest.mark.parametrize("copies", [None, 3])
def test_a_layer_that_changes_a_shape_and_says_so_is_taken(copies: int | None) -> None:
    layers = [Doubled]
    env: Any = rcs.make("Free", layers=layers) if copies is None else rcs.make_vec("Free", copies=copies, layers=layers)
    observation, _ = env.reset(seed=0)
    assert observation["joints"].shape == ((14,) if copies is None else (copies, 14))
    env.step(env.action_space.sample())
    env.close()
