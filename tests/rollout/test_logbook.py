"""Which episodes of a ledger decide that an evaluation ends early."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from rcs_data.ledger import Pairs

import rcs
from rcs.agents.identity import identity_of
from rcs.rollout.collection import Attempt
from rcs.rollout.episode import EpisodeResult
from rcs.rollout.evaluate import evaluate
from rcs.rollout.evaluation import Evaluation, Summary
from rcs.rollout.logbook import Logbook, condition_of
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
