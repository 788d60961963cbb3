"""The contract of all environments, as tests."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from contextlib import closing
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from rcs.errors import InvalidAction, WrongOrder

AnyEnv = gymnasium.Env[Any, Any]
Action = dict[str, Any]
Boxes = Mapping[str, spaces.Box]
"""The spaces of one robot's action."""


def _change(new: Callable[[spaces.Box, Any], Any]) -> Callable[[Boxes, Action], Any]:
    """Make a function that spoils the first entry of a valid action."""

    def spoil(boxes: Boxes, action: Action) -> Any:
        key = next(iter(action))
        return {**action, key: new(boxes[key], action[key])}

    return spoil


def _with_first(value: Callable[[spaces.Box], float]) -> Callable[[Boxes, Action], Any]:
    def replace(box: spaces.Box, array: Any) -> Any:
        changed = np.array(array)
        changed[0] = value(box)
        return changed

    return _change(replace)


BAD_ACTIONS: dict[str, Callable[[Boxes, Action], Any]] = {
    "nothing": lambda boxes, action: None,
    "an array instead of a dictionary": lambda boxes, action: next(iter(action.values())),
    "no keys": lambda boxes, action: {},
    "a missing key": lambda boxes, action: dict(list(action.items())[1:]),
    "an unknown key": lambda boxes, action: {**action, "no such key": np.zeros(1)},
    "too short": _change(lambda box, array: array[1:]),
    "too long": _change(lambda box, array: np.append(array, array[:1])),
    "an axis too many": _change(lambda box, array: array[None]),
    # A plain number is valid for a gripper.
    "a number instead of an array": lambda boxes, action: {
        **action,
        next((key for key in action if boxes[key].shape != (1,)), "no such key"): 0.0,
    },
    "text": _change(lambda box, array: ["0.0"] * len(array)),
    "objects": _change(lambda box, array: np.array([None] * len(array))),
    "booleans": _change(lambda box, array: np.zeros(box.shape, np.bool_)),
    "complex numbers": _change(lambda box, array: array.astype(np.complex128)),
    "rows of different lengths": _change(lambda box, array: [[0.0], [0.0, 0.0]]),
    "not a number": _with_first(lambda box: np.nan),
    "infinite": _with_first(lambda box: np.inf),
    "minus infinite": _with_first(lambda box: -np.inf),
    "above the bounds": _with_first(lambda box: float(box.high[0]) + 0.01),
    "below the bounds": _with_first(lambda box: float(box.low[0]) - 0.01),
}
"""Actions of a robot that no environment may accept."""


OF_THE_MOMENT = {"ages", "late"}
"""Entries of an info that differ between runs of the same episode: how old readings are, and how late a step."""


class EnvContract:
    """Checks an environment whose actions and observations are dictionaries of arrays, of several robots one each."""

    steps: int = 4
    """How many steps a comparison takes."""
    longest_episode: int = 50
    """After how many steps an episode of `make_env` is over at the latest; 0 if it never ends."""
    is_reset_complete: bool = True
    """Whether a reset with a seed leads to the same state every time; a real robot stays where it is."""

    def make_env(self) -> AnyEnv:
        """Return a new environment, equal to the last one, not reset. To be overridden."""
        raise NotImplementedError("override make_env and return a new environment")

    def sample_action(self, env: AnyEnv) -> Action:
        """Return a valid action; drawn from the action space, which `run` has seeded."""
        return env.action_space.sample()

    def env(self) -> closing[AnyEnv]:
        """Return an environment that is closed in the end."""
        return closing(self.make_env())

    def run(self, env: AnyEnv, *, between: Callable[[Any], None] | None = None) -> list[Any]:
        """Return what an environment gives from reset on, over `steps` steps of the same actions every time.

        Args:
            env: The environment.
            between: Is called with every observation after a copy of it was taken.
        """
        env.action_space.seed(7)
        observation, info = env.reset(seed=7)
        seen: list[Any] = [copy.deepcopy((observation, info))]
        for _ in range(self.steps):
            if between is not None:
                between(observation)
            observation, *rest = env.step(self.sample_action(env))
            seen.append(copy.deepcopy((observation, *rest)))
        return seen

    def test_spaces_are_dictionaries_with_finite_action_bounds(self) -> None:
        """So that an action can be drawn and checked."""
        with self.env() as env:
            assert isinstance(env.observation_space, spaces.Dict)
            for boxes in _robots(env).values():
                for box in boxes.values():
                    assert np.isfinite(box.low).all()
                    assert np.isfinite(box.high).all()
                    assert (box.low < box.high).all()

    def test_observations_are_in_their_space(self) -> None:
        """Keys, shapes, dtypes and bounds, from reset on."""
        with self.env() as env:
            for observation, *_ in self.run(env):
                _require_inside(env.observation_space, observation)

    def test_the_same_seed_gives_the_same_bits_in_another_environment(self) -> None:
        """Observations, rewards, flags and infos have the same bits."""
        with self.env() as one, self.env() as other:
            require_same_bits(self.run(other), self.run(one))

    def test_the_same_seed_gives_the_same_bits_twice_in_a_row(self) -> None:
        """Nothing of an episode is left after reset."""
        if not self.is_reset_complete:
            pytest.skip("a reset of this environment does not lead to the same state every time")
        with self.env() as env:
            first = self.run(env)
            require_same_bits(self.run(env), first)

    def test_reset_takes_an_empty_dictionary_of_options(self) -> None:
        """As gymnasium's wrappers and checkers give it."""
        with self.env() as env:
            observation, info = env.reset(seed=3, options={})
            _require_inside(env.observation_space, observation)
            assert isinstance(info, dict)

    def test_reset_works_without_a_seed(self) -> None:
        """At first, and again."""
        with self.env() as env:
            for _ in range(2):
                observation, _ = env.reset()
                _require_inside(env.observation_space, observation)

    def test_a_step_before_the_first_reset_is_refused(self) -> None:
        """There is nothing to step yet."""
        with self.env() as env, pytest.raises(WrongOrder):
            env.step(self.sample_action(env))

    def test_a_closed_environment_refuses_every_call(self) -> None:
        """And closing twice is harmless."""
        env = self.make_env()
        env.reset(seed=0)
        env.close()
        env.close()
        with pytest.raises(WrongOrder):
            env.step(self.sample_action(env))
        with pytest.raises(WrongOrder):
            env.reset(seed=0)

    def test_closing_is_harmless_before_the_first_reset(self) -> None:
        """Nothing was opened."""
        env = self.make_env()
        env.close()
        env.close()

    def test_a_step_after_the_end_of_an_episode_is_refused(self) -> None:
        """Until reset."""
        if not self.longest_episode:
            pytest.skip("episodes of this environment do not end")
        with self.env() as env:
            env.action_space.seed(7)
            env.reset(seed=7)
            for _ in range(self.longest_episode):
                _, _, terminated, truncated, _ = env.step(self.sample_action(env))
                if terminated or truncated:
                    break
            else:
                pytest.fail(f"the episode is not over after {self.longest_episode} steps")
            with pytest.raises(WrongOrder):
                env.step(self.sample_action(env))
            env.reset(seed=7)
            env.step(self.sample_action(env))

    @pytest.mark.parametrize("kind", BAD_ACTIONS)
    def test_a_bad_action_is_refused_and_changes_nothing(self, kind: str) -> None:
        """The steps after it are, bit for bit, those without it; of several robots it is the last one's."""
        with self.env() as env, self.env() as untouched:

            def try_it(_: Any) -> None:
                robots = _robots(env)
                actions: dict[str, Any] = {
                    name: {key: box.low.copy() for key, box in boxes.items()} for name, boxes in robots.items()
                }
                last = list(robots)[-1]
                actions[last] = BAD_ACTIONS[kind](robots[last], actions[last])
                with pytest.raises(InvalidAction):
                    env.step(actions.get(ONLY, actions))

            require_same_bits(self.run(env, between=try_it), self.run(untouched))

    def test_writing_to_an_observation_changes_nothing(self) -> None:
        """Observations are the caller's own, or cannot be written to, such as frames."""
        with self.env() as env, self.env() as untouched:
            require_same_bits(self.run(env, between=_spoil), self.run(untouched))

    def test_an_observation_stays_as_it_is_when_the_environment_goes_on(self) -> None:
        """No array is used again."""
        with self.env() as env:
            kept: list[Any] = []
            copies = self.run(env, between=kept.append)
            require_same_bits(kept, [observation for observation, *_ in copies[: len(kept)]])

    def test_writing_to_an_action_after_the_step_changes_nothing(self) -> None:
        """Actions are copied."""
        with self.env() as env, self.env() as untouched:
            expected = self.run(untouched)
            env.action_space.seed(7)
            seen: list[Any] = [env.reset(seed=7)]
            for _ in range(self.steps):
                action = self.sample_action(env)
                seen.append(env.step(action))
                _spoil(action)
            require_same_bits(seen, expected)


def require_same_bits(a: Any, b: Any, path: str = "") -> None:
    """Check that two trees of arrays and numbers are the same, bit for bit, and name the first place where not.

    Args:
        a: Dictionaries, sequences, arrays, numbers, in any nesting.
        b: The other one, to compare it with.
        path: Place in the tree, for the message.
    """
    if isinstance(a, Mapping):
        assert isinstance(b, Mapping), path
        assert a.keys() == b.keys(), f"{path}: {sorted(a)} and {sorted(b)}"
        for key in a.keys() - OF_THE_MOMENT:
            require_same_bits(a[key], b[key], f"{path}/{key}")
    elif isinstance(a, list | tuple):
        assert len(a) == len(b), path
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            require_same_bits(x, y, f"{path}/{i}")
    elif isinstance(a, np.ndarray | np.generic):
        x, y = np.asarray(a), np.asarray(b)
        assert (x.shape, x.dtype) == (y.shape, y.dtype), f"{path}: {x.shape} {x.dtype} and {y.shape} {y.dtype}"
        assert x.tobytes() == y.tobytes(), f"{path}: {x} and {y}"
    else:
        assert type(a) is type(b), path
        assert a == b or (a != a and b != b), f"{path}: {a} and {b}"


ONLY = ""
"""Stand-in for the name of a robot that is alone."""


def _robots(env: AnyEnv) -> dict[str, Boxes]:
    """Return the spaces of every robot's action."""
    space = env.action_space
    assert isinstance(space, spaces.Dict)
    inner = {name: one for name, one in space.spaces.items() if isinstance(one, spaces.Dict)}
    return {name: _boxes(one) for name, one in inner.items()} if inner else {ONLY: _boxes(space)}


def _boxes(space: spaces.Dict) -> Boxes:
    boxes = {key: box for key, box in space.spaces.items() if isinstance(box, spaces.Box)}
    assert boxes.keys() == space.spaces.keys()
    return boxes


def _require_inside(space: spaces.Space[Any], observation: Any, path: str = "observation") -> None:
    if isinstance(space, spaces.Dict):
        assert observation.keys() == space.spaces.keys(), f"{path}: {sorted(observation)}"
        for key, inner in space.spaces.items():
            _require_inside(inner, observation[key], f"{path}/{key}")
    else:
        assert isinstance(observation, np.ndarray), path
        assert (observation.shape, observation.dtype) == (space.shape, space.dtype), path
        assert space.contains(observation), f"{path}: {observation} is not in {space}"


def _spoil(tree: Any) -> None:
    if isinstance(tree, Mapping):
        for value in tree.values():
            _spoil(value)
    elif tree.flags.writeable:
        tree[...] = 1
