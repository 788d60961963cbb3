"""A task names its expert, in three ways."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import rcs
from rcs.agents import PickExpert, agent_for
from rcs.agents.agent import is_path
from rcs.errors import InvalidSetup, UnknownName
from rcs.tasks.pick_cuboid import PickCuboid


@pytest.mark.parametrize("expert", ["PickExpert", "rcs.agents.experts:PickExpert", PickExpert])
def test_an_expert_is_found_by_entry_point_by_place_and_by_class(expert: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PickCuboid, "expert", expert)
    assert type(agent_for(rcs.make("PickCuboid"))) is PickExpert


def test_an_expert_that_is_not_installed_is_refused_with_the_nearest_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PickCuboid, "expert", "PickExprt")
    with pytest.raises(UnknownName, match="'PickExpert'"):
        agent_for(rcs.make("PickCuboid"))


def test_a_task_without_an_expert_says_so() -> None:
    with pytest.raises(InvalidSetup, match=r"no scripted expert.*'Free'"):
        agent_for(rcs.make("Free"))


@pytest.mark.parametrize(("task", "robot"), [("PickCuboid", "fr3"), ("LiftBar", "dual_fr3"), ("PickToy", "xarm7")])
def test_the_expert_of_a_task_acts_in_it_and_is_made_for_it_alone(task: str, robot: str) -> None:
    env = rcs.make(task, robot=robot)
    expert = agent_for(env)
    observation, info = env.reset(seed=0)
    expert.reset(observation, info)
    assert env.action_space.contains(expert.act(observation, info))
    assert expert.rate is None
    assert expert.notes() == {}
    assert list(expert.events()) == []
    expert.close()
    expert.close()


def test_a_folder_here_takes_no_name_away(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names = ("PickCuboid", "planner", "my_run")
    for name in names:
        (tmp_path / name).mkdir()
    assert [is_path(name) for name in names] == [False, False, True]
    assert is_path("./PickCuboid")
