"""The ledger of an evaluation: which episodes decide that it ends early, who judged, and that nothing is lost."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from rcs_data import Dataset, DatasetWriter
from rcs_data.ledger import Ledger, Pairs

import rcs
from rcs.agents.identity import identity_of
from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.observers.recorder import Recorder
from rcs.rollout.collection import Attempt
from rcs.rollout.episode import EpisodeResult
from rcs.rollout.evaluate import evaluate
from rcs.rollout.evaluation import Evaluation, Summary
from rcs.rollout.logbook import Logbook, condition_of
from rcs.rollout.person import PersonJudge
from tests.rollout.staying import SETUP, Stay, run


def test_only_episodes_before_the_first_that_runs_decide(tmp_path: Path) -> None:
    run(out=tmp_path, episodes=8, agent=None, setup=rcs.Setup(task="PickCuboid", max_episode_steps=150))
    evaluation = Evaluation(
        setup=SETUP, agent=Stay, episodes=8, out=tmp_path, against="PickExpert", until=0.05, name="idle"
    )
    identity = identity_of(Stay, "PickCuboid")
    with Logbook(evaluation, identity, condition_of(evaluation, identity)) as book:
        failed = EpisodeResult(seed=0, steps=4, success=False, failure="timeout", reward=0.0)
        summary = Summary(attempts=[Attempt(number=number, result=failed) for number in range(1, 8)])
        assert not book.is_decided(summary), "episode 0 may still succeed"
        summary.attempts.append(Attempt(number=0, result=failed))
        assert book.is_decided(summary)
        assert book.pairs.only_b == 7


def test_the_agent_to_decide_against_may_have_the_same_name(tmp_path: Path) -> None:
    one = Evaluation(setup=SETUP, agent=Stay, name="stay", episodes=2, out=tmp_path)
    list(evaluate(one))
    other = replace(one, setup=replace(SETUP, frequency=10.0), against="stay", until=0.05)
    assert len(list(evaluate(other))) == 2
    assert list(evaluate(other, summary := Summary())) == []
    assert (summary.found, summary.pairs) == (2, Pairs(neither=2))


def test_episodes_that_other_processes_have_written_decide_too(tmp_path: Path) -> None:
    identity = identity_of(Stay, "PickCuboid")
    better = Evaluation(setup=SETUP, agent=Stay, episodes=8, out=tmp_path, name="better")
    idle = replace(better, name="idle", against="better", until=0.05)
    done = EpisodeResult(seed=0, steps=4, success=True, failure=None, reward=0.0)
    failed = [Attempt(number=number, result=replace(done, success=False, failure="timeout")) for number in range(8)]
    with Logbook(better, identity, condition_of(better, identity)) as book:
        for number in range(8):
            book.add(Attempt(number=number, result=done))
    condition = condition_of(idle, identity)
    with Logbook(idle, identity, condition) as other, Logbook(idle, identity, condition) as mine:
        summary = Summary()
        for attempt in failed[1::2]:
            mine.add(attempt)
            summary.attempts.append(attempt)
        assert not mine.is_decided(summary), "episode 0 still runs elsewhere"
        for attempt in failed[::2]:
            other.add(attempt)
        mine.ledger.refresh()
        assert mine.is_decided(summary)
        assert list(mine.missing(summary)) == []
    list(evaluate(idle, summary := Summary()))
    assert (summary.found, summary.pairs) == (8, Pairs(only_b=7)), "what came after the decision does not count"


def test_an_answer_that_is_taken_back_at_the_end_counts_in_what_was_decided(tmp_path: Path) -> None:
    identity = identity_of(Stay, "PickCuboid")
    better = Evaluation(setup=SETUP, agent=Stay, episodes=7, out=tmp_path, name="better")
    done = EpisodeResult(seed=0, steps=4, success=True, failure=None, reward=0.0)
    with Logbook(better, identity, condition_of(better, identity)) as book:
        for number in range(7):
            book.add(Attempt(number=number, result=done))
    idle, summary = replace(better, name="idle", against="better", until=0.05), Summary()
    lines = iter([*"nnnnnnn", "u", "y", ""])
    judge = PersonJudge(lambda question, observation, seed: next(lines))
    list(evaluate(idle, summary, env=rcs.make(SETUP), judge=judge))
    assert (summary.is_decided, summary.pairs) == (True, Pairs(only_b=7))
    judge.end()
    assert (summary.is_decided, summary.pairs) == (False, Pairs(both=1, only_b=6))


@pytest.mark.parametrize(
    ("own_failure", "tags", "judge"),
    [("fault", (), "task"), ("diverged", (), "task"), ("timeout", ("fault",), "person"), ("timeout", (), "person")],
)
def test_the_person_judges_only_what_they_were_asked_about(
    tmp_path: Path, own_failure: str, tags: tuple[str, ...], judge: str
) -> None:
    identity = identity_of(Stay, "PickCuboid")
    evaluation = Evaluation(setup=SETUP, agent=Stay, episodes=1, out=tmp_path)
    failure = next(iter(tags), own_failure)
    result = EpisodeResult(
        seed=0, steps=4, success=False, failure=failure, reward=0.0, tags=tags, own_failure=own_failure
    )
    with Logbook(evaluation, identity, condition_of(evaluation, identity), "person") as book:
        book.add(Attempt(number=0, result=result))
        (row,) = book.ledger.rows.values()
    assert (row.failure, row.judge) == (failure, judge)


def test_an_answer_is_in_the_ledger_before_its_recording_is_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def end(*_: object, **__: object) -> None:
        monkeypatch.undo()
        raise KeyboardInterrupt  # as a kill, while images and columns are put together

    env = rcs.make(SETUP)
    evaluation = Evaluation(setup=SETUP, agent=Stay, episodes=2, out=tmp_path / "ledger")
    with DatasetWriter.open(tmp_path / "data", dataset_info(env)) as writer:
        env.add_observer(recorder := Recorder(writer))
        monkeypatch.setattr(recorder, "finish", end)
        with pytest.raises(KeyboardInterrupt):
            list(evaluate(evaluation, env=env, judge=lambda observation, info: True, recorder=recorder))
    (row,) = Ledger(tmp_path / "ledger").rows.values()
    assert (row.success, row.judge) == (True, "person")
    (recorded,) = Dataset.open(tmp_path / "data").episodes
    assert (recorded.id, recorded.success) == (f"000000-{row.key}", None), "what was recorded is kept, too"
