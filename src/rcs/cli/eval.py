"""`rcs eval`: how often an agent succeeds."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path

from rcs.cli.console import plain_console
from rcs.cli.runs import INTERRUPTED, RunOptions, interruptible, results_table, show
from rcs.rollout.evaluate import Evaluation, Summary, evaluate


@dataclass(kw_only=True)
class EvalCommand(RunOptions):
    """Run an agent in seeded episodes and show how often it succeeds.

    Episode i depends on the seed and on i alone, whatever the number of workers: two agents meet the same starts.
    Ctrl-C ends after the episodes at work, a second one at once; the figures of those that ended are written anyway.
    """

    episodes: int = 50
    """Number of episodes."""
    cameras: tuple[str, ...] | None = ()
    """Cameras that the agent sees; without them, episodes are fast."""
    video: bool = False
    """Write videos of the first ten episodes."""
    videos: int | None = None
    """Write videos of this many of the first episodes."""
    out: Path = field(default_factory=lambda: Path("evaluation"))
    """Folder for the figures and the videos."""

    def run(self) -> int:
        """Evaluate, print the results and return the exit code."""
        videos = (10 if self.video else 0) if self.videos is None else self.videos
        evaluation = Evaluation(
            setup=self.setup(),
            agent=self.agent,
            episodes=self.episodes,
            seed=self.seed,
            workers=self.processes,
            ray=self.cluster,
            videos=videos,
            out=self.out,
        )
        console, summary = plain_console(soft_wrap=False), Summary()
        started = time.perf_counter()
        try:
            with interruptible(summary, console):
                title = f"{self.task} on {self.robot}"
                show(
                    evaluate(evaluation, summary), title, self.episodes, console, summary, lambda: len(summary.attempts)
                )
        finally:
            if summary.attempts:
                console.print(
                    results_table(summary, time.perf_counter() - started, summary.cluster or evaluation.workers)
                )
                console.print(f"Figures: {summary.write(evaluation)}", soft_wrap=True)
                if videos:
                    console.print(f"Videos: {self.out}", soft_wrap=True)
        return INTERRUPTED if summary.is_interrupted else 0
