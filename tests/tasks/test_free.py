from __future__ import annotations

import numpy as np
import pytest

import rcs
from rcs.cli.list import ListCommand
from rcs.tasks.free import Free


def test_nothing_is_won_and_nothing_ends() -> None:
    env = rcs.make("Free")
    observation, info = env.reset(seed=0)
    again, _ = env.reset(seed=1)
    np.testing.assert_array_equal(observation["joints"], again["joints"])
    assert info == {}
    _, reward, terminated, truncated, info = env.step(env.action_space.sample())
    assert (reward, terminated, truncated) == (0.0, False, False)
    assert "success" not in info


def test_copies_have_an_outcome_each() -> None:
    envs = rcs.make_vec("Free", copies=3)
    envs.reset(seed=0)
    _, reward, terminated, _, _ = envs.step(envs.action_space.sample())
    for value in (reward, terminated):
        np.testing.assert_array_equal(value, np.zeros(3))


def test_a_task_without_a_docstring_is_listed_by_its_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Free, "__doc__", None)
    assert ListCommand().run() == 0
    assert ["task", "Free", "Free"] in [line.split() for line in capsys.readouterr().out.splitlines()]
