"""A person's answers: read from lines, taken back, and asked for once everything is in its place."""

from __future__ import annotations

import os
import pty
import select
from pathlib import Path
from typing import Any

import pytest
from rcs_data.ledger import Ledger

import rcs
from rcs.errors import Refused
from rcs.rollout import Answer, Evaluation, Outlines, PersonJudge, Summary, evaluate
from rcs.rollout.person import answer_in, ask_at_terminal, read_line
from tests.rollout.staying import SETUP, Stay


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("y", Answer(success=True)),
        (" No ", Answer(success=False)),
        ("? #blurred", Answer(success=None, tags=("blurred",))),
        ("n 2 #slip #late out of the left 3rd finger", Answer(
            success=False, stages=2, tags=("slip", "late"), words="out of the left 3rd finger")),
        ("y 3 well, 3 of 3", Answer(success=True, stages=3, words="well, 3 of 3")),
        ("", None), ("yn", None), ("u", None), ("2 y", None),
    ],
)  # fmt: skip
def test_a_line_is_a_verdict_and_then_stages_tags_and_words(line: str, answer: Answer | None) -> None:
    assert answer_in(line) == answer


def test_a_line_that_was_typed_before_a_question_does_not_answer_it(monkeypatch: pytest.MonkeyPatch) -> None:
    keyboard, terminal = pty.openpty()

    def read(_: str) -> str:
        os.write(keyboard, b"n\n")
        return lines.readline().strip()

    with os.fdopen(terminal) as lines:
        monkeypatch.setattr("sys.stdin", lines)
        monkeypatch.setattr("builtins.input", read)
        os.write(keyboard, b"y\n")
        assert select.select([terminal], [], [], 5.0)[0], "it has arrived"
        assert read_line("Is the way free?") == "n"
    os.close(keyboard)


def test_a_line_that_is_no_text_is_asked_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, lines = list[str](), iter(["n pinc\udce9", "n pince"])

    def answer(question: str) -> str:
        asked.append(question)
        return next(lines)

    monkeypatch.setattr("builtins.input", answer)
    assert ask_at_terminal("Done?", {}, None) == "n pince"
    assert asked == ["Done?: ", "That was no text. Done?: "]


class Script:
    """Answers with given lines, and keeps the questions."""

    def __init__(self, *lines: str) -> None:
        self.lines, self.asked = list(lines), list[tuple[str, int | None]]()

    def __call__(self, question: str, observation: Any, seed: int | None) -> str:
        self.asked.append((question, seed))
        return self.lines.pop(0)


def judged(out: Path | None, script: Script, episodes: int = 3, **options: Any) -> Summary:
    evaluation, summary = Evaluation(setup=SETUP, agent=Stay, episodes=episodes, out=out), Summary()
    env = rcs.make(SETUP)
    with Outlines(SETUP) as outlines:
        judge = PersonJudge(script, outlines=outlines, **options)
        for _ in evaluate(evaluation, summary, env=env, judge=judge):
            pass
        judge.end()
    return summary


def test_the_last_answer_can_be_taken_back_and_the_ledger_has_the_new_one(tmp_path: Path) -> None:
    # `u` is no answer to the first question; then `n 1` becomes `y 3`, and the very last `y` becomes `?`.
    script = Script("", "u", "n 1 #slip", "u", "what", "y 3 all the way", "n 2 #slip", "y", "u", "? #dark", "")
    summary = judged(tmp_path / "out", script)
    assert script.lines == []
    ledger = Ledger(tmp_path / "out")
    rows = list(ledger.rows.values())
    assert [(row.success, row.stages, row.tags, row.message) for row in rows] == [
        (True, 3, (), "all the way"), (False, 2, ("slip",), None), (None, None, ("dark",), None),
    ]  # fmt: skip
    assert [(row.failure, row.judge) for row in rows] == [(None, "person"), ("slip", "person"), (None, "nobody")]
    assert [attempt.result.success for attempt in summary.attempts] == [True, False, None]
    assert len((tmp_path / "out" / "ledger.jsonl").read_text().splitlines()) == 5
    assert ledger.damage == []
    again = judged(tmp_path / "out", Script())
    assert (again.found, [one.result.success for one in again.attempts]) == (3, [True, False, None])


def test_objects_are_put_in_place_before_an_episode_begins_and_while_the_one_before_is_judged() -> None:
    script = Script("", "y", "y", "")
    judged(None, script, episodes=2)
    seeds = [Evaluation(setup=SETUP, episodes=2).seed_of(number) for number in range(2)]
    assert [seed for _, seed in script.asked] == [*seeds, None, None]
    with Outlines(SETUP) as outlines:
        for (question, _), seed in zip(script.asked, seeds, strict=False):
            assert outlines.words(seed) in question
    assert "[u]ndo" not in script.asked[1][0]
    assert "[u]ndo" in script.asked[2][0]


def test_only_what_was_answered_can_be_taken_back() -> None:
    taken: list[tuple[str, Answer]] = []
    judge = PersonJudge(Script("y", "u", "n", "y"))
    judge({}, {})
    judge.answered(lambda answer: taken.append(("judged", answer)))
    judge.answered(lambda answer: taken.append(("ended by a fault", answer)))  # nobody was asked about this one
    assert judge({}, {}) == Answer(success=True)
    assert taken == [("judged", Answer(success=False))]


def test_where_no_answer_can_be_taken_back_none_is_offered() -> None:
    script = Script("", "y", "u", "n")
    judged(None, script, episodes=2, can_undo=False)
    assert script.lines == []
    assert all("[u]ndo" not in question for question, _ in script.asked)


def test_an_input_that_stays_no_text_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    def answer(_: str = "") -> str:
        raise UnicodeDecodeError("utf-8", b"\xc3", 0, 1, "unexpected end of data")

    monkeypatch.setattr("builtins.input", answer)
    with pytest.raises(Refused, match="no text"):
        ask_at_terminal("Done?", {}, None)


def test_an_episode_after_a_fault_waits_until_its_objects_are_in_their_places() -> None:
    script = Script("", "y", "", "")
    with rcs.make(SETUP) as env, Outlines(SETUP) as outlines:
        judge = PersonJudge(script, outlines=outlines)
        judge.announce(env, 1, 2)
        judge({}, {})
        judge.announce(env, 2, 3)  # begun by the answer; it ends in a fault, and nobody is asked how it went
        judge.announce(env, 3, None)
        judge.announce(env, 4, None)
    assert [seed for _, seed in script.asked] == [1, 2, 3, 4]
    assert ["Then press Enter" in question for question, _ in script.asked] == [True, False, True, True]


def test_only_an_empty_line_begins_an_episode_that_no_answer_has_begun() -> None:
    script = Script("n", "u", "y 3", " ", "left")
    with rcs.make("Free", hardware="fake") as env:
        PersonJudge(script).announce(env, 0, None)
    assert script.lines == ["left"]
    assert ["begins nothing" in question for question, _ in script.asked] == [False, True, True, True]
    assert all("press Enter, or Go on" in question for question, _ in script.asked)


@pytest.mark.parametrize(("hardware", "asked"), [("fake", 1), (None, 0)])
def test_without_objects_real_arms_wait_for_somebody_and_simulated_ones_do_not(hardware: Any, asked: int) -> None:
    script = Script("")
    with rcs.make("Free", hardware=hardware) as env:
        PersonJudge(script).announce(env, 0, None)
    assert len(script.asked) == asked


def test_an_interruption_while_objects_are_put_in_their_places_begins_no_episode() -> None:
    summary = Summary()

    def interrupt(question: str, observation: Any, seed: int | None) -> str:
        summary.is_interrupted = True
        return ""

    evaluation = Evaluation(setup=SETUP, agent=Stay, episodes=1)
    with Outlines(SETUP) as outlines:
        judge = PersonJudge(interrupt, outlines=outlines)
        assert list(evaluate(evaluation, summary, env=rcs.make(SETUP), judge=judge)) == []
