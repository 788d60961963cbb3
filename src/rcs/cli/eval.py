"""`rcs eval`: how often an agent succeeds."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Annotated

import tyro
from rcs_data.cli.console import plain_console
from rcs_data.cli.program import INTERRUPTED

from rcs.cli.runs import LedgerOptions, PoolOptions, attempts_of, interruptible, print_results, show
from rcs.cli.setup_options import SetupOptions
from rcs.rollout.evaluation import Evaluation, Summary


@dataclass(kw_only=True)
class EvalCommand(SetupOptions):
    """Run an agent in seeded episodes, and show how often it succeeds.

    `rcs eval RUN` takes the best checkpoint of a training, in the environment that it was trained in. Episode i depends
    on the seed and on i alone, whatever the number of workers: two agents meet the same starts. Each episode that ends
    is in the ledger, and the same command goes on after a kill. Ctrl-C ends after the running episodes, a second one at
    once.
    """

    episodes: int = 50
    """Number of episodes."""
    pool: Annotated[PoolOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=PoolOptions)
    ledger: Annotated[LedgerOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=LedgerOptions)

    def run(self) -> int:
        """Evaluate, print the results and return the exit code."""
        evaluation = Evaluation(
            setup=self.setup(),
            agent=self.actor,
            episodes=self.episodes,
            seed=self.seed,
            workers=self.pool.processes(self.episodes),
            ray=self.pool.ray,
            **self.ledger.checked(),
        )
        console, summary = plain_console(soft_wrap=False), Summary()
        attempts, made_by = attempts_of(evaluation, summary, self.pool)
        started, videos = time.perf_counter(), 0
        try:
            with interruptible(summary, console):
                title = f"{evaluation.setup.task} on {evaluation.setup.robot_label}"
                show(attempts, title, len(evaluation.numbers), console, summary)
            videos = self.ledger.videos
        finally:
            print_results(evaluation, summary, videos, time.perf_counter() - started, made_by, console)
        return INTERRUPTED if summary.is_interrupted else 0
