"""Two policies compared blindly: whoever judges does not know which of them, X or Y, acts."""

from __future__ import annotations

import logging
import random
import secrets
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import partial

from rcs_data.ledger import Condition, Ledger
from rcs_data.ledger.condition import BLIND

from rcs.agents.identity import Identity, identity_of
from rcs.envs.env import Env
from rcs.envs.observers.recorder import Recorder
from rcs.errors import InvalidSetup, RcsError
from rcs.rollout.collection import Attempt
from rcs.rollout.episode import Judge
from rcs.rollout.evaluate import Evaluator, correct
from rcs.rollout.evaluation import Evaluation, Summary
from rcs.rollout.logbook import Logbook, condition_of
from rcs.rollout.person import PersonJudge

LETTERS = ("X", "Y")
_TELLING = logging.getLogger("rcs.policy.execution")
"""Logs the words of policies and of connections to them."""
_GONE = (
    "A policy cannot be reached, or does not return, so this episode was not begun; its words would name it. See that "
    "both policies answer, and run the same again to go on."
)


class _Unnamed(logging.Filter):
    """Leaves words out of a log that would say which policy acts."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Keep a record without them."""
        failed, again = "A policy failed, and the robot holds; its words would name it.", "The policy answers again."
        record.msg, record.args = failed if record.levelno >= logging.ERROR else again, ()
        return True


def evaluate_blind(
    evaluations: tuple[Evaluation, Evaluation],
    summary: Summary,
    env: Env,
    *,
    judge: Judge | None = None,
    recorder: Recorder | None = None,
) -> Iterator[Attempt]:
    """Run two agents on the same seeds in an order that is balanced and drawn, and yield each attempt.

    Nothing shows which of the two acts, not even a letter: a judge would soon know the better letter. The ledger has
    the letters, and the agents behind them in a form that nobody reads by accident, until `Ledger.unblind`. Weights,
    addresses and messages of policies are left out. The letters are drawn anew for each comparison; the same
    evaluations go on where they were stopped.

    Args:
        evaluations: The evaluations, which differ in the agent alone, and have a folder.
        summary: Collects the attempts of both.
        env: The environment, which stays open.
        judge: Returns whether an episode was a success, in the place of the task.
        recorder: Records every episode.

    Raises:
        InvalidSetup: An agent does not fit the environment, or both are the same.
        RcsError: As `evaluate`.
    """
    out = evaluations[0].out
    assert out is not None
    who = "task" if judge is None else "person"
    identities = [identity_of(one.agent, one.setup.task) for one in evaluations]
    true = [condition_of(one, who, env) for one, who in zip(evaluations, identities, strict=True)]
    if true[0].hash == true[1].hash:
        raise InvalidSetup(f"Both policies are {true[0].agent} with the same weights; there is nothing to compare.")
    with ExitStack() as stack:
        _TELLING.addFilter(unnamed := _Unnamed())
        stack.callback(_TELLING.removeFilter, unnamed)
        evaluators = []
        for one in evaluations:
            evaluators.append(Evaluator(one, env=env, judge=judge, recorder=recorder, keeps_env=True))
            stack.callback(evaluators[-1].close)
        with Ledger.open(out) as ledger:
            blind = _blinded(ledger, true, identities)
        books = [
            stack.enter_context(Logbook(one, identity, condition, who, is_blind=True))
            for one, identity, condition in zip(evaluations, identities, blind, strict=True)
        ]
        for book, evaluator in zip(books, evaluators, strict=True):
            evaluator.condition = book.hash
            book.take(there := Summary())  # both have the same numbers
            summary.attempts += there.attempts
        by_letter = sorted(range(2), key=lambda which: blind[which].agent)
        turns = [(number, by_letter[letter]) for number, letter in order_of(evaluations[0])]
        for place, (number, which) in enumerate(turns):
            if summary.is_interrupted:
                return
            if books[which].is_missing(number):
                if isinstance(judge, PersonJudge):
                    later = (one for one, other in turns[place + 1 :] if books[other].row_of(one) is None)
                    coming, seed_of = next(later, None), evaluations[0].seed_of
                    judge.announce(env, seed_of(number), None if coming is None else seed_of(coming))
                    if summary.is_interrupted:  # while somebody prepared the episode
                        return
                try:
                    attempt = evaluators[which].attempt(number)
                except RcsError as err:
                    if type(err) is not RcsError:  # such as that of a device, which says nothing about who acts
                        raise
                    raise RcsError(_GONE) from None
                evaluators[which].keep(attempt, books[which].add)
                summary.attempts.append(attempt)
                if isinstance(judge, PersonJudge):
                    judge.answered(partial(correct, books[which], summary, len(summary.attempts) - 1))
                yield attempt


def order_of(evaluation: Evaluation) -> Iterator[tuple[int, int]]:
    """Yield numbers of episodes and of letters: both on each seed, each first on one of every two seeds, as drawn."""
    draw = random.Random(evaluation.seed)
    firsts: list[int] = []
    for number in evaluation.numbers:
        if not firsts:
            firsts = draw.sample(range(2), 2)
        first = firsts.pop()
        yield from ((number, first), (number, 1 - first))


def _blinded(ledger: Ledger, true: list[Condition], identities: list[Identity]) -> list[Condition]:
    """Return the conditions of both under letters, described: those of an earlier start of the same two, or new ones.

    With letters of another comparison, a policy would take over its episodes, and whose they are would show.
    """
    starts: dict[str, dict[str, Condition]] = {}
    for blind, own in ledger.blind():
        starts.setdefault(blind.tags[BLIND], {})[own.hash] = blind
    for known in starts.values():
        if known.keys() == {one.hash for one in true}:
            return [known[one.hash] for one in true]
    letters, nonce = list(LETTERS), secrets.token_hex(8)
    secrets.SystemRandom().shuffle(letters)
    blinded: list[Condition] = []
    for one, letter, identity in zip(true, letters, identities, strict=True):
        tags = {**one.tags, BLIND: nonce}
        blinded.append(replace(one, agent=letter, weights=None, trained=None, data=None, policy={}, tags=tags))
        ledger.register(blinded[-1], hidden=(one, identity.place))
    return blinded
