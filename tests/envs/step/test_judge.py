"""A simulation that diverges is reset by MuJoCo; whatever is said of that step is of the moment before."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs.step.judge import _with_last
from rcs.testing.env_contract import require_same_bits
from tests.envs.notebook import Notebook

KEYS = ("time", "cuboid", "edges", "is_grasped", "is_touched", "success")
"""Info about the state of the task PickCuboid."""


@pytest.fixture(autouse=True)
def _log(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log there


def of_task(info: dict[str, Any]) -> dict[str, Any]:
    return {key: np.array(info[key]) for key in KEYS}


def diverge(env: Any) -> tuple[Any, ...]:
    env.simulation.world.qvel[0] = np.nan
    return env.step(env.action_space.sample())


@pytest.mark.parametrize("steps", [0, 3])
def test_info_of_a_diverged_step_is_of_the_last_good_observation(steps: int) -> None:
    env = rcs.make("PickCuboid")
    env.action_space.seed(0)
    observation, info = env.reset(seed=3)
    for _ in range(steps):
        observation, *_, info = env.step(env.action_space.sample())
    expected = of_task(info)
    assert (expected["time"] > 0) == (steps > 0)
    seen, *_, info = diverge(env)
    assert info["end"] == "diverged"
    require_same_bits(seen, observation)
    require_same_bits(of_task(info), expected)
    assert not np.array_equal(env.simulation.task.evaluate().info["cuboid"], expected["cuboid"]), "it was reset"
    assert isinstance(info["time"], float)
    assert isinstance(info["is_grasped"], bool)


def test_info_of_a_step_that_diverges_right_after_a_state_was_set_is_of_that_state() -> None:
    env, other = rcs.make("PickCuboid"), rcs.make("PickCuboid")
    env.reset(seed=3)
    for _ in range(3):
        *_, info = env.step(env.action_space.sample())
    other.reset(seed=4)
    other.set_state(env.get_state())
    require_same_bits(of_task(diverge(other)[-1]), of_task(info))


def test_info_of_a_copy_that_diverges_is_of_its_last_good_observation_and_the_others_go_on() -> None:
    envs = rcs.make_vec("PickCuboid", copies=3)
    singles = [rcs.make("PickCuboid") for _ in range(3)]
    envs.action_space.seed(0)
    envs.reset(seed=11)
    notebooks = [Notebook() for _ in range(3)]
    for copy, single in enumerate(singles):
        single.reset(seed=11 + copy)
        envs.add_observer(notebooks[copy], copy=copy)
    infos: list[Any] = [{}, {}, {}]

    def step() -> Any:
        actions = envs.action_space.sample()
        *_, info = envs.step(actions)
        for copy, single in enumerate(singles):
            if copy != 1 or info["end"][1] != "diverged":
                *_, infos[copy] = single.step({key: value[copy] for key, value in actions.items()})
        return info

    for _ in range(3):
        step()
    envs.simulation.world.qvel[1, 0] = np.nan
    info = step()
    assert info["end"].tolist() == ["period", "diverged", "period"]
    for copy in range(3):
        require_same_bits({key: info[key][copy] for key in KEYS}, of_task(infos[copy]))
        *_, before, last = notebooks[copy].seen
        assert np.isfinite(last.sim_state).all()
        assert np.array_equal(before.sim_state, last.sim_state) == (copy == 1)
        assert last.info["time"] == infos[copy]["time"]
    assert step()["time"][1] == 0.0, "its next episode has begun"


@pytest.mark.parametrize("is_watched_before", [True, False])
def test_observers_see_the_state_of_the_last_good_observation(is_watched_before: bool) -> None:
    env, notebook = rcs.make("PickCuboid"), Notebook()
    if is_watched_before:
        env.add_observer(notebook)
    env.reset(seed=0)
    for _ in range(2):
        env.step(env.action_space.sample())
    if not is_watched_before:
        env.add_observer(notebook)
    diverge(env)
    if not is_watched_before:
        assert notebook.seen == [], "the state before is not known"
        return
    *_, before, last = notebook.seen
    assert len(notebook.seen) == 4
    assert last.truncated
    np.testing.assert_array_equal(last.sim_state, before.sim_state)
    np.testing.assert_array_equal(last.objects["cuboid"], before.objects["cuboid"])
    assert last.info["time"] == before.info["time"]
    assert last.capture_times == before.capture_times
    assert last.time > before.time


def test_rows_of_the_last_info_replace_new_ones_in_any_nesting() -> None:
    new = {"a": np.zeros((3, 2)), "b": {"c": np.array([True, True, True])}, "fresh": np.arange(3), "words": "new"}
    last = {"a": np.ones((3, 2)), "b": {"c": np.array([False, False, False])}, "words": "old"}
    merged = _with_last(new, last, np.array([False, True, False]))
    np.testing.assert_array_equal(merged["a"], [[0, 0], [1, 1], [0, 0]])
    np.testing.assert_array_equal(merged["b"]["c"], [True, False, True])
    np.testing.assert_array_equal(merged["fresh"], [0, 1, 2])
    whole = _with_last(new, last, None)
    np.testing.assert_array_equal(whole["a"], last["a"])
    assert whole["a"] is not last["a"], "whoever was given that may write into it"
    assert whole["words"] == "old"
