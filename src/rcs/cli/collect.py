"""`rcs collect`: a dataset of episodes that an agent makes, with a report page."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rcs_data.cli.console import plain_console
from rcs_data.cli.program import INTERRUPTED
from rcs_data.view import write_report
from rich.console import Console

from rcs.cli.runs import PoolOptions, interruptible, results_table, show
from rcs.cli.setup_options import SetupOptions, flags, recorded_cameras
from rcs.envs.setup import Setup
from rcs.errors import DeviceFault, InvalidSetup
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Kept, Progress
from rcs.rollout.evaluation import Summary
from rcs.rollout.placing import is_placed_by_robot
from rcs.rollout.supervisor import Supervisor, TerminalSupervisor, VirtualSupervisor, supervisor_of

if TYPE_CHECKING:
    CollectFlags = Setup
else:
    CollectFlags = flags(cameras="all")


@dataclass(kw_only=True)
class CollectCommand(SetupOptions):
    """Collect a dataset of scripted episodes and write a report page.

    Episode i depends only on the seed and on i, so the same command resumes an interrupted collection, and neither the
    number of workers nor a cluster changes the data. Ctrl-C ends after the running episodes; a second one ends at once.

    With `--task-options placed_by=robot`, the robot sets the object down where the next episode begins, after each
    success, in simulation and with `--hardware`; otherwise, and after a failure, it is placed as without this option.

    With `--hardware`, arms are real. Before each episode they go home, slowly, and a person puts the objects where the
    terminal says; afterwards, the person says whether the task was done. A virtual robot does both by itself.
    """

    environment: Annotated[CollectFlags, tyro.conf.OmitArgPrefixes] = field(default_factory=CollectFlags)
    """The fields of `rcs.Setup` and `rcs.Cameras`, as in Python; but for cameras, which are all, as a dataset is to be
    seen and learned from."""
    kept: Annotated[Kept, tyro.conf.OmitArgPrefixes] = field(default_factory=Kept)
    pool: Annotated[PoolOptions, tyro.conf.OmitArgPrefixes] = field(default_factory=PoolOptions)
    out: Path = field(default_factory=lambda: Path("datasets/collected"))
    """Folder of the dataset."""
    report: bool = True
    """Write report.html."""
    hardware: str | None = None
    """Real devices: the JSON file of a site, or `driver:address` for all arms with their end effectors. Cameras are
    then those of the site, if none are given."""
    yes: bool = False
    """Do not ask before motions: somebody watches the arms."""

    def run(self) -> int:
        """Collect, print the results and return the exit code."""
        console = plain_console(soft_wrap=False)
        setup = self.setup(cameras=recorded_cameras(self.hardware))
        is_single = bool(self.hardware) or is_placed_by_robot(setup)
        collection = Collection(
            setup=setup,
            out=self.out,
            seed=self.seed,
            agent=self.actor,
            workers=1 if is_single and not self.pool.workers else self.pool.processes(self.kept.episodes),
            ray=self.pool.ray,
            hardware=self.hardware,
            **vars(self.kept),
        )
        started = time.perf_counter()
        progress = Progress()
        with interruptible(progress, console):
            try:
                self._collect(collection, progress, console)
            except DeviceFault:
                console.print(f"{collection.out} has {progress.kept} episodes; the same command goes on from there.")
                raise
        _summarise(collection, progress, console)
        if self.report and progress.kept:
            page = write_report(collection.out, wall_time=progress.seconds or None)
            console.print(f"Report: {page}", soft_wrap=True)
        console.print(f"Dataset: {collection.out}   ({time.perf_counter() - started:.1f} s in all)", soft_wrap=True)
        return INTERRUPTED if progress.is_interrupted else 0

    def _collect(self, collection: Collection, progress: Progress, console: Console) -> None:
        supervisor: Supervisor | None = None
        if self.hardware is not None:
            supervisor = supervisor_of(collection.setup, self.hardware, is_agreed=self.yes)
        attempts = collect(collection, progress, supervisor=supervisor)
        if isinstance(supervisor, TerminalSupervisor):
            if not sys.stdin.isatty():
                raise InvalidSetup("The input is no terminal, and a person at a terminal places objects and judges.")
            for attempt in attempts:  # a bar would write over the questions
                text = {True: "done", False: "not done", None: "not known"}[attempt.result.success]
                console.print(f"Episode {attempt.number + 1} of {self.kept.episodes}: {text}")
            return
        if isinstance(supervisor, VirtualSupervisor):
            console.print(f"{supervisor.name} is a virtual robot, which places its objects and judges by itself.")
        title = f"{collection.setup.task} on {collection.setup.robot_label}"
        made = Summary(attempts=progress.attempts)
        show(attempts, title, self.kept.episodes, console, made, lambda: progress.kept)


def _summarise(collection: Collection, progress: Progress, console: Console) -> None:
    if progress.found:
        console.print(f"{progress.found} episodes existed already.")
    if progress.again:
        console.print(f"{progress.again} episodes cut short by a kill were collected again.")
    if progress.attempts:
        summary = Summary(attempts=progress.attempts)
        workers = f"Ray cluster {collection.ray}" if collection.ray else collection.workers
        console.print(results_table(summary, progress.seconds, workers))
    elif not progress.is_interrupted:
        console.print(f"Nothing to do: {collection.out} has {progress.kept} episodes.", soft_wrap=True)
