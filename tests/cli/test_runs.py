"""The bar and the table of commands with episodes."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from rcs.cli.runs import print_results, results_table, show
from rcs.errors import InvalidSetup
from rcs.rollout.collection import Attempt
from rcs.rollout.episode import EpisodeResult
from rcs.rollout.evaluate import evaluate
from rcs.rollout.evaluation import Evaluation, Summary
from tests.rollout.staying import SETUP, Stay


def attempt(number: int, success: bool | None) -> Attempt:
    result = EpisodeResult(seed=number, steps=4, success=success, failure=None, reward=0.0)
    return Attempt(number=number, result=result)


def shown(summary: Summary, found: list[Attempt], made: list[Attempt], total: int) -> str:
    """Return what the bar shows in the end."""

    def attempts() -> Iterator[Attempt]:
        summary.attempts = [replace(one, is_found=True) for one in found]
        for one in made:
            summary.attempts.append(one)
            yield one

    file = io.StringIO()
    show(attempts(), "title", total, Console(file=file, width=200), summary)
    return file.getvalue()


def test_repetitions_are_counted_as_runs_and_not_in_the_rate() -> None:
    first, again = [attempt(0, True), attempt(1, False)], [attempt(2, True), attempt(3, True)]
    told = shown(Summary(episodes=2), [], [*first, *again], 4)
    assert "4/4" in told
    assert "50.0 % success" in told


def test_episodes_that_were_found_are_not_counted_among_those_to_be_run() -> None:
    first, again = [attempt(0, True), attempt(1, False)], [attempt(2, True), attempt(3, True)]
    told = shown(Summary(episodes=2), first, again, 4)
    assert "2/2" in told
    assert "50.0 % success" in told


def printed(attempts: list[Attempt]) -> str:
    """Return the table of first runs."""
    file = io.StringIO()
    Console(file=file, width=200).print(results_table(Summary(attempts=attempts, episodes=len(attempts)), 1.0, 1))
    return file.getvalue()


def test_steps_of_other_processes_do_not_count_in_the_speed() -> None:
    others = replace(attempt(1, True), is_found=True)
    others = replace(others, result=replace(others.result, steps=400))
    assert "1 episodes in 1.0 s: 1.00/s, 1200 per 20 minutes, 4 steps/s" in printed([attempt(0, True), others])


def test_episodes_without_a_verdict_are_told_beside_the_rate() -> None:
    told = printed([attempt(0, True), attempt(1, None), attempt(2, None)]).splitlines()
    assert any(line.startswith("success") and "1 of 1 = 100.0 %" in line for line in told)
    assert any(line.split() == ["not", "judged", "2"] for line in told)
    assert "not judged" not in printed([attempt(0, True)])


def test_the_page_is_written_though_no_film_can_be_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise InvalidSetup("no picture to film")

    evaluation, summary = Evaluation(setup=SETUP, agent=Stay, episodes=1, out=tmp_path), Summary()
    list(evaluate(evaluation, summary))
    monkeypatch.setattr("rcs.cli.runs.film", fail)
    file = io.StringIO()
    with pytest.raises(InvalidSetup, match="no picture to film"):
        print_results(evaluation, summary, 1, 1.0, 1, Console(file=file, width=200))
    assert (tmp_path / "report.html").is_file()
    assert "Report: " in file.getvalue()
