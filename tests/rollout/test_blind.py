"""Letters of blind comparisons; `tests/cli/test_blind.py` has whole ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rcs_data.ledger import Condition, Ledger

import rcs
from rcs.agents.identity import Identity
from rcs.errors import RcsError
from rcs.rollout import Evaluation, Outlines, PersonJudge, Summary
from rcs.rollout.blind import LETTERS, _blinded, evaluate_blind
from tests.rollout.staying import SETUP, Stay


def two(*names: str) -> tuple[list[Condition], list[Identity]]:
    """Return conditions of two agents, and who they are."""
    conditions = [
        Condition(agent=name, weights=f"{name}hash", task="Free", robot="fr3", setup={}, tags={"mix": "half"})
        for name in names
    ]
    return conditions, [Identity(name=name, place=f"vla://{name}") for name in names]


def test_the_same_two_go_on_with_their_letters_and_others_get_new_ones(tmp_path: Path) -> None:
    with Ledger.open(tmp_path) as ledger:
        first = _blinded(ledger, *two("a", "b"))
        assert sorted(one.agent for one in first) == list(LETTERS)
        assert _blinded(ledger, *two("b", "a")) == first[::-1]
        other = _blinded(ledger, *two("a", "c"))
        assert sorted(one.agent for one in other) == list(LETTERS)
        assert not {one.hash for one in other} & {one.hash for one in first}, "no episode of A is taken over"
        assert (_blinded(ledger, *two("a", "b")), _blinded(ledger, *two("a", "c"))) == (first, other)
        revealed = {blind.hash: true.agent for blind, true in ledger.unblind()}
        assert [revealed[one.hash] for one in (*first, *other)] == ["a", "b", "a", "c"]
        assert _blinded(ledger, *two("a", "b")) != first, "who they are is known by now"


def test_a_start_that_was_cut_off_between_the_two_letters_is_not_gone_on_with(tmp_path: Path) -> None:
    with Ledger.open(tmp_path) as ledger:
        _, lost = _blinded(ledger, *two("a", "b"))
        next(path for path in (tmp_path / "conditions").iterdir() if path.stem == lost.hash).unlink()
        assert sorted(one.agent for one in _blinded(ledger, *two("a", "b"))) == list(LETTERS)


class Remain(Stay):
    """Does the same under another name."""


class Fickle(Stay):
    """Has other weights from its first episode on."""

    weights: str | None = None

    def reset(self, observation: Any, info: Any) -> None:
        self.weights = "new"


def test_weights_that_change_do_not_tell_the_letter(tmp_path: Path) -> None:
    one, other = (Evaluation(setup=SETUP, agent=agent, episodes=1, out=tmp_path) for agent in (Fickle, Remain))
    with rcs.make(SETUP) as env, pytest.raises(RcsError, match=r"^The weights of a policy changed .* is left out"):
        list(evaluate_blind((one, other), Summary(), env))


def test_an_interruption_while_objects_are_put_in_their_places_begins_no_episode(tmp_path: Path) -> None:
    summary = Summary()

    def interrupt(question: str, observation: Any, seed: int | None) -> str:
        summary.is_interrupted = True
        return ""

    one, other = (Evaluation(setup=SETUP, agent=agent, episodes=1, out=tmp_path) for agent in (Stay, Remain))
    with rcs.make(SETUP) as env, Outlines(SETUP) as outlines:
        judge = PersonJudge(interrupt, outlines=outlines)
        assert list(evaluate_blind((one, other), summary, env, judge=judge)) == []
