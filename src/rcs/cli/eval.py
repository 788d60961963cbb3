"""`rcs eval`: how often an agent succeeds."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from rcs_data.cli.console import plain_console
from rcs_data.cli.program import INTERRUPTED

from rcs.agents.agent import is_path
from rcs.cli.runs import RunOptions, evaluation_folder, interruptible, results_table, show
from rcs.rollout.collect import Attempt
from rcs.rollout.evaluate import Evaluation, Summary, evaluate


@dataclass(kw_only=True)
class EvalCommand(RunOptions):
    """Run an agent in seeded episodes and show how often it succeeds.

    `rcs eval RUN` takes the best checkpoint of a training, in the environment that it was trained in. Episode i depends
    on the seed and on i alone, whatever the number of workers: two agents meet the same starts. Ctrl-C ends after the
    episodes at work, a second one at once; the figures of those that ended are written anyway.
    """

    episodes: int = 50
    """Number of episodes."""
    video: bool = False
    """Write videos of the first ten episodes."""
    videos: int | None = None
    """Write videos of this many of the first episodes."""
    out: Path | None = None
    """New folder for the figures and the videos; by default `evaluation`, or `evaluation-2` and so on."""

    def run(self) -> int:
        """Evaluate, print the results and return the exit code."""
        videos = (10 if self.video else 0) if self.videos is None else self.videos
        evaluation = Evaluation(
            out=evaluation_folder(self.out),
            setup=self.setup(),
            agent=self.actor,
            episodes=self.episodes,
            seed=self.seed,
            workers=self.processes,
            ray=self.cluster,
            videos=videos,
        )
        console, summary = plain_console(soft_wrap=False), Summary()
        if is_path(evaluation.agent):
            console.print(f"Policy: {evaluation.agent}", soft_wrap=True)
        made_by: int | str = evaluation.workers
        started = time.perf_counter()
        try:
            with interruptible(summary, console):
                title = f"{evaluation.setup.task} on {evaluation.setup.robot_label}"
                attempts, made_by = self._attempts(evaluation, summary)
                show(attempts, title, self.episodes, console, summary, lambda: len(summary.attempts))
        finally:
            if summary.attempts:
                seconds = time.perf_counter() - started
                console.print(results_table(summary, seconds, summary.cluster or made_by))
                console.print(f"Figures: {summary.write(evaluation)}", soft_wrap=True)
                if videos:
                    console.print(f"Videos: {evaluation.out}", soft_wrap=True)
        return INTERRUPTED if summary.is_interrupted else 0

    def _attempts(self, evaluation: Evaluation, summary: Summary) -> tuple[Iterator[Attempt], int | str]:
        """Return the attempts, and who makes them."""
        has_choice = self.workers == 0 and self.cluster is None
        if has_choice and is_path(evaluation.agent) and not evaluation.setup.cameras:
            # Processes would each load torch; with cameras they are faster, for each draws and sees by itself.
            from rcs.rl.evaluate import COPIES, evaluate_in_batch

            copies = min(COPIES, self.episodes - min(evaluation.videos, self.episodes))
            return evaluate_in_batch(evaluation, summary), f"one, with a batch of {copies} copies" if copies else "one"
        return evaluate(evaluation, summary), evaluation.workers
