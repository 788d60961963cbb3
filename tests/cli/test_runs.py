"""The bar and the table of commands with episodes."""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import replace

from rich.console import Console

from rcs.cli.runs import results_table, show
from rcs.rollout.collection import Attempt
from rcs.rollout.episode import EpisodeResult
from rcs.rollout.evaluation import Summary


def attempt(number: int, success: bool) -> Attempt:
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


def test_steps_of_other_processes_do_not_count_in_the_speed() -> None:
    others = replace(attempt(1, True), is_found=True)
    others = replace(others, result=replace(others.result, steps=400))
    file = io.StringIO()
    table = results_table(Summary(attempts=[attempt(0, True), others], episodes=2), 1.0, 1)
    Console(file=file, width=200).print(table)
    assert "1 episodes in 1.0 s: 1.00/s, 1200 per 20 minutes, 4 steps/s" in file.getvalue()
