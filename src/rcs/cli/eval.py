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
from rcs.cli.simulator_options import SimulatorOptions
from rcs.errors import InvalidSetup
from rcs.rollout.evaluation import Evaluation, Summary
from rcs.rollout.foreign import setup_of_simulator


@dataclass(kw_only=True)
class EvalCommand(SetupOptions):
    """Run an agent in seeded episodes, and show how often it succeeds.

    `rcs eval RUN` takes the best checkpoint of a training, in the environment that it was trained in. Episode i depends
    on the seed and on i alone, whatever the number of workers: two agents meet the same starts. Each episode that ends
    is in the ledger, and the same command goes on after a kill. Ctrl-C ends after the running episodes, a second one at
    once.
    """

    task: tyro.conf.Positional[str] = ""  # pyright: ignore[reportGeneralTypeIssues, reportIncompatibleVariableOverride]
    """Name of the task, such as PickCuboid, or `module:Class`; or the path of a checkpoint, or of a run, for the
    environment that it was trained in. None with `--simulator`."""
    episodes: int = 50
    """Number of episodes."""
    simulation: Annotated[SimulatorOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=SimulatorOptions)
    pool: Annotated[PoolOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=PoolOptions)
    ledger: Annotated[LedgerOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=LedgerOptions)

    def run(self) -> int:
        """Evaluate, print the results and return the exit code."""
        simulator = self.simulation.foreign([*self.given, *["task"] * bool(self.task)])
        if simulator is not None and self.agent is None:
            raise InvalidSetup("A simulator of another project has no expert: name who acts with --agent.")
        if simulator is None and not self.task:
            raise InvalidSetup("Give a task, such as `rcs eval PickCuboid`, a checkpoint, or a --simulator.")
        is_single = simulator is not None and self.pool.workers == 0 and self.pool.ray is None
        workers = 1 if is_single else self.pool.processes(self.episodes)
        evaluation = Evaluation(
            setup=self.setup() if simulator is None else setup_of_simulator(simulator),
            simulator=simulator,
            agent=self.actor,
            episodes=self.episodes,
            seed=self.seed,
            workers=workers,
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
