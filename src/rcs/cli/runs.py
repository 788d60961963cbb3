"""Parts that commands with episodes share: their processes, a bar, the results, and the reaction to Ctrl-C."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Protocol

from rcs_data.files.output import require_writable
from rcs_data.ledger import Ledger, Row, write_ledger_page
from rcs_data.ledger.compare import compare
from rcs_data.ledger.ledger import FILMS_FOLDER, LEDGER_FILE
from rcs_data.options import require_whole
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from rcs.agents.agent import is_path
from rcs.rollout.collection import Attempt
from rcs.rollout.episode import EpisodeResult
from rcs.rollout.evaluate import evaluate, film
from rcs.rollout.evaluation import Evaluation, Summary
from rcs.rollout.logbook import differs
from rcs.rollout.video import cut_films

ENDING = "Ending after the running episodes; press Ctrl-C again to end at once."
"""Message at the first Ctrl-C."""


@dataclass(kw_only=True)
class PoolOptions:
    """Processes that run episodes."""

    workers: int = 0
    """Processes; 0 for one per CPU core, of the whole cluster with `--ray`."""
    ray: str | None = None
    """Address of a Ray cluster for the processes: `auto` for the one that this machine is a part of, or `host:port`;
    needs the extra `ray`."""

    def processes(self, episodes: int) -> int:
        """Return how many workers to start: no more than there are episodes; 0 for one per CPU of a cluster.

        Raises:
            InvalidSetup: The number of workers is negative.
        """
        require_whole("workers", self.workers)
        return self.workers if self.ray else min(self.workers or os.cpu_count() or 1, max(episodes, 1))


@dataclass(kw_only=True)
class LedgerOptions:
    """The ledger of an evaluation."""

    out: Path = Path("evaluation")
    """Folder of the ledger, which may have other evaluations; episodes that are there are not run again."""
    name: str | None = None
    """Name of the agent in the ledger; by default its own, such as `pick@40000`."""
    tags: dict[str, str] | None = None
    """Names and values for the ledger, by which figures can be drawn, such as `mix half`."""
    repeat: int = 0
    """How many more times to run each episode, even if the ledger has it."""
    against: str | None = None
    """Another agent in the ledger, by name or hash, for `--until`."""
    until: float | None = None
    """Level, such as 0.05: end as soon as the seeds shared with `--against` show which agent is better."""
    videos: int = 0
    """How many episodes to run once more, from their seeds, and film; failures come first."""

    def checked(self) -> dict[str, Any]:
        """Return the fields of an `Evaluation` that these options are.

        Raises:
            InvalidSetup: `videos` is below 0.
            DatasetError: The folder cannot be written.
        """
        require_whole("videos", self.videos)
        require_writable(self.out)
        given = {own.name: getattr(self, own.name) for own in fields(self) if own.name != "videos"}
        return {**given, "tags": self.tags or {}}


def attempts_of(evaluation: Evaluation, summary: Summary, pool: PoolOptions) -> tuple[Iterator[Attempt], int | str]:
    """Return the attempts of an evaluation, and who makes them."""
    if pool.workers == 0 and pool.ray is None and is_path(evaluation.agent) and not evaluation.setup.cameras:
        # Processes would each load torch; with cameras they are faster, for each draws and sees by itself.
        from rcs.rl.evaluate import COPIES, evaluate_in_batch

        copies = min(COPIES, evaluation.episodes)
        return evaluate_in_batch(evaluation, summary), f"one, with a batch of {copies} copies"
    made_by: int | str = (evaluation.ray and f"Ray cluster {evaluation.ray}") or evaluation.workers
    return evaluate(evaluation, summary), made_by


def print_results(
    evaluation: Evaluation,
    summary: Summary,
    videos: int,
    seconds: float,
    workers: int | str,
    console: Console,
    record: Path | None = None,
) -> None:
    """Print the results of an evaluation, film some of its episodes, and write the page about the ledger.

    Args:
        evaluation: The evaluation, which has a folder.
        summary: Its results; nothing is printed without any.
        videos: How many episodes to film.
        seconds: How long it took [s].
        workers: The processes that ran it, in words or as a number.
        console: Where to print.
        record: The dataset in which the episodes were recorded, for films of real ones.
    """
    if not summary.attempts or evaluation.out is None:
        return
    console.print(results_table(summary, seconds, workers))
    with Ledger(evaluation.out) as ledger:
        try:
            if videos and not summary.is_interrupted:
                _film(evaluation, ledger, summary.condition, videos, record, console)
        finally:  # whatever becomes of films
            if evaluation.against is not None:
                other = ledger.find(evaluation.against, besides=summary.condition)
                (one,) = compare(ledger, [summary.condition, other])
                one = replace(one, pairs=summary.pairs or one.pairs, until=evaluation.until)
                console.print(one.words, soft_wrap=True)
            for sentence in ledger.damage:
                console.print(sentence, soft_wrap=True)
            console.print(f"Ledger: {evaluation.out / LEDGER_FILE}", soft_wrap=True)
            console.print(f"Report: {write_ledger_page(ledger)}", soft_wrap=True)


def _film(
    evaluation: Evaluation, ledger: Ledger, condition: str, videos: int, record: Path | None, console: Console
) -> None:
    """Film episodes, and print which of them ended differently."""
    if ledger.condition(condition).is_real:
        if record is None:
            console.print("Real episodes are filmed from their recording: give --record, too.", soft_wrap=True)
            return
        cut_films(record, ledger, condition, videos)
    else:
        for row, result in film(evaluation, videos):
            if differs(row, result):
                console.print(
                    f"Seed {row.seed} ended differently when it was filmed: {_outcome(row)}, then {_outcome(result)}. "
                    "Its film is removed.",
                    soft_wrap=True,
                )
    console.print(f"Videos: {ledger.folder / FILMS_FOLDER}", soft_wrap=True)


def _outcome(result: Row | EpisodeResult) -> str:
    verdict = {True: "success", False: "failure", None: "not judged"}[result.success]
    return f"{result.failure or verdict} after {result.steps} steps"


class Interruptible(Protocol):
    """A run that ends after what is running once it is interrupted."""

    is_interrupted: bool


def show(
    attempts: Iterable[Attempt],
    title: str,
    total: int,
    console: Console,
    summary: Summary,
    done: Callable[[], int] | None = None,
) -> None:
    """Go through attempts with a bar that shows how many succeed and how fast they are made.

    The bar counts those that are to be run, repetitions among them; the rate is that of the results, without them.

    Args:
        attempts: Each is made when it is requested.
        title: Words before the bar.
        total: How many there shall be in the end, with those that were found.
        console: Where the bar is.
        summary: Their results so far.
        done: Returns how many there are; None for all in the summary.
    """
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[text]}", markup=False),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    done = done or (lambda: len(summary.attempts))
    made = found = 0
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(title, total=total, text="")
        start = time.perf_counter()
        try:
            for made, _ in enumerate(attempts, 1):
                found = summary.found if made == 1 else found  # the last attempt may be followed by those of others
                text = f"{_rate(summary)}, {made / (time.perf_counter() - start):.2f} episodes/s"
                bar.update(task, total=total - found, completed=min(done(), total) - found, text=text)
            bar.update(task, completed=min(done(), total) - found)
        except BaseException:
            if not made:  # an empty bar says nothing: the error stands alone
                bar.live.transient = bar.disable = True
                bar.live.stop()
            raise


def results_table(summary: Summary, seconds: float, workers: int | str) -> Table:
    """Return how attempts went, and how fast they were made.

    Args:
        summary: The attempts, at least one.
        seconds: Wall time [s].
        workers: How many processes made them, or where they were made, in words.
    """
    made = len(summary.attempts) - summary.found
    steps = sum(attempt.result.steps for attempt in summary.attempts if not attempt.is_found)
    low, high = (100 * bound for bound in summary.interval)
    interval = f"{summary.successes} of {summary.judged} = {_rate(summary, '')} (95 % Wilson interval {low:.1f} to "
    rate = made / seconds
    speed = f"{made} episodes in {seconds:.1f} s: {rate:.2f}/s, {1200 * rate:.0f} per 20 minutes"
    speed = f"{speed}, {steps / seconds:.0f} steps/s" if made else "none was run"
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column()
    table.add_column(overflow="fold")  # a long path is never cut
    if (identity := summary.identity) is not None:
        weights = "" if identity.weights is None else f", weights {identity.weights[:16]}"
        place = f" at {identity.place}" if identity.place else ""
        table.add_row("agent", f"{identity.name}{place}{weights}")
    table.add_row("success", f"{interval}{high:.1f} %)" if summary.judged else "not judged")
    if left_out := len(summary.results) - summary.judged:
        table.add_row("not judged", str(left_out))
    table.add_row("failures", ", ".join(f"{name} {count}" for name, count in summary.failures.most_common()) or "none")
    if repeated := len(summary.repetitions):
        table.add_row("repetitions", f"{repeated} repeated, {summary.changed} ended differently")
    if summary.found:
        table.add_row("found", f"{summary.found} of {len(summary.attempts)} episodes were in the ledger")
    table.add_row("speed", speed)
    table.add_row("workers", str(workers))
    return table


def _rate(summary: Summary, word: str = " success") -> str:
    return f"{100 * summary.successes / summary.judged:.1f} %{word}" if summary.judged else "not judged"


@contextmanager
def interruptible(run: Interruptible, console: Console, text: str = ENDING) -> Generator[None]:
    """Let the first Ctrl-C end a run, which says so, after what is running; the second, or SIGTERM, at once."""

    def on_interrupt(number: int, frame: object) -> None:
        if run.is_interrupted:
            raise KeyboardInterrupt
        run.is_interrupted = True
        console.print(text)

    def on_termination(number: int, frame: object) -> None:
        raise KeyboardInterrupt  # who sends it will not wait for long: close what is open, and end

    before = {
        signal.SIGINT: signal.signal(signal.SIGINT, on_interrupt),
        signal.SIGTERM: signal.signal(signal.SIGTERM, on_termination),
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
