"""Evaluations: the same starts for everyone, figures, and videos of the first episodes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from rcs_data.verdicts import wilson_interval

import rcs
from rcs.agents import Agent
from rcs.errors import InvalidSetup, UnknownName, WrongOrder
from rcs.rollout.collect import seed_of
from rcs.rollout.evaluate import Evaluation, Summary, evaluate

SETUP = rcs.Setup(task="PickCuboid", max_episode_steps=4)
"""Episodes that end before anything is picked."""


class Stay(Agent):
    """Keeps every joint and every gripper where it is."""

    def __init__(self, env: Any) -> None:
        self._action = env.action_space.sample()
        self._action["joints"][:] = 0.0
        self._action["gripper"][:] = 1.0

    def reset(self, observation: Any, info: Any) -> None:
        """Nothing to forget."""

    def act(self, observation: Any, info: Any) -> Any:
        return self._action


def run(**options: Any) -> Summary:
    summary = Summary()
    for _ in evaluate(Evaluation(**{"setup": SETUP, "agent": Stay, "episodes": 3, **options}), summary):
        pass
    return summary


def test_the_expert_succeeds_and_who_stays_does_not() -> None:
    expert = run(setup=rcs.Setup(task="PickCuboid"), agent=None, episodes=2)
    assert (expert.successes, expert.judged, dict(expert.failures)) == (2, 2, {})
    idle = run()
    assert (idle.successes, idle.judged, dict(idle.failures)) == (0, 3, {"timeout": 3})
    assert idle.interval == wilson_interval(0, 3)


def test_episodes_depend_on_the_seed_and_their_number_alone() -> None:
    one, many = run(seed=5), run(seed=5, workers=2)
    assert one.to_json() == many.to_json()
    assert [result.seed for result in one.results] == [seed_of(5, number) for number in range(3)]
    assert {result.seed for result in run(seed=6).results}.isdisjoint(result.seed for result in one.results)


def test_where_nobody_judges_nothing_is_counted() -> None:
    free = run(setup=rcs.Setup(task="Free", max_episode_steps=2))
    assert (free.judged, free.to_json()["success_rate"], dict(free.failures)) == (0, None, {})
    assert free.interval == (0.0, 1.0)


def test_a_judge_takes_the_place_of_the_task() -> None:
    summary = Summary()
    evaluation = Evaluation(setup=SETUP, agent=Stay, episodes=2, workers=2)
    for _ in evaluate(evaluation, summary, judge=lambda observation, info: True):
        pass
    assert summary.successes == 2


def test_an_interrupted_evaluation_keeps_what_was_done() -> None:
    summary = Summary()
    for _ in evaluate(Evaluation(setup=SETUP, agent=Stay, episodes=100), summary):
        summary.is_interrupted = len(summary.attempts) == 2
    assert len(summary.attempts) == 2


def test_a_given_environment_is_used_and_closed() -> None:
    env = rcs.make(SETUP)
    attempts = list(evaluate(Evaluation(setup=SETUP, agent=Stay(env), episodes=1, workers=4), env=env))
    assert attempts[0].result.steps == 4
    with pytest.raises(WrongOrder, match="closed"):
        env.reset()


def test_an_unknown_agent_leaves_no_environment_open() -> None:
    env = rcs.make(SETUP)
    with pytest.raises(UnknownName, match="Stey"):
        next(evaluate(Evaluation(setup=SETUP, agent="Stey", episodes=1), env=env))
    with pytest.raises(WrongOrder, match="closed"):
        env.reset()


@pytest.mark.parametrize("field", ["episodes", "seed", "workers", "videos"])
@pytest.mark.parametrize("value", [-1, 1.5, True])
def test_numbers_that_make_no_sense_are_refused(field: str, value: Any) -> None:
    with pytest.raises(InvalidSetup, match=f"{field} is"):
        Evaluation(**{"setup": SETUP, field: value})


def test_the_file_says_what_was_evaluated_and_how_every_episode_went(tmp_path: Path) -> None:
    evaluation = Evaluation(setup=SETUP, agent=Stay, episodes=2, out=tmp_path / "new" / "folder")
    summary = Summary()
    assert len(list(evaluate(evaluation, summary))) == 2
    told = json.loads(summary.write(evaluation).read_text())
    assert rcs.Setup.from_json({**told["setup"]}) == SETUP
    assert told["agent"] == f"{__name__}:Stay"
    assert [result["failure"] for result in told["results"]] == ["timeout", "timeout"]
    assert told["versions"]["robot-control-stack"] == rcs.__version__


@pytest.mark.gl
@pytest.mark.parametrize("workers", [1, 2])
def test_there_are_as_many_videos_as_were_asked_for(tmp_path: Path, workers: int) -> None:
    run(videos=2, workers=workers, out=tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["000000.mp4", "000001.mp4"]


def test_real_devices_alone_have_no_video(tmp_path: Path) -> None:
    env = rcs.make("Free", hardware="fake")
    with pytest.raises(InvalidSetup, match="no picture to film"):
        next(evaluate(Evaluation(setup=env.setup, agent=Stay, videos=1, out=tmp_path), env=env))
