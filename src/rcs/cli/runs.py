"""What commands share: options of an environment; of `rcs collect` and `rcs eval` an agent, a bar and the results."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from rcs_data.output import require_writable
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from rcs.agents.agent import is_path
from rcs.cli.setup_options import SetupOptions
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.rollout.cluster import LOCAL
from rcs.rollout.collect import Attempt
from rcs.rollout.evaluate import Summary
from rcs.rollout.ray_pool import ClusterUsage
from rcs.sim.world import Stepping
from rcs.spatial import Pose

ENDING = "Ending after the episodes at work; Ctrl-C again ends at once."
"""What is told at the first Ctrl-C."""


USUAL_FOLDER = Path("evaluation")
"""Folder of an evaluation for which none is given; with a number where it is taken."""


@dataclass(kw_only=True)
class ActorOptions(SetupOptions):
    """Options of a command in whose environment an agent may act."""

    agent: str | None = None
    """Name of the agent, `module:Class`, which is called with the environment, or the path of a checkpoint. By default
    the task's expert, or the policy of the checkpoint that is given in place of the task."""

    @property
    def actor(self) -> str | None:
        """Who acts; None for the expert of the task. Of a run, it is the checkpoint that is best now."""
        actor = self.checkpoint if self.agent is None else self.agent
        if not is_path(actor):
            return actor
        from rcs.rl.checkpoint import find_checkpoint

        return str(find_checkpoint(str(actor), trust=self.trust).path)

    @property
    def checkpoint(self) -> str | None:
        """Path of the checkpoint, or of the run, whose environment is used; None for one of a task."""
        return super().checkpoint or (self.agent if is_path(self.agent) else None)

    def setup(self, stepping: Stepping | None = None, **usual: Any) -> Setup:
        """Return the setup of the options; see `SetupOptions.setup`.

        Raises:
            InvalidSetup: The agent is a checkpoint of another task.
        """
        setup = super().setup(stepping, **usual)
        if not is_path(self.task) and setup.task != self.task:
            raise InvalidSetup(f"The checkpoint {self.agent} was trained for {setup.task}, not for {self.task}.")
        return setup


@dataclass(kw_only=True)
class RunOptions(ActorOptions):
    """Options of a command that runs an agent in seeded episodes."""

    episodes: int = 20
    """How many episodes."""
    workers: int = 0
    """Processes; 0 for one per CPU core, with `--ray-address` of the whole cluster."""
    ray: bool = False
    """Run the processes with Ray, on this machine if there is no `--ray-address`; needs the extra `ray`."""
    ray_address: str | None = None
    """Address of a Ray cluster for the processes: `auto` for the one that this machine is a part of, or `host:port`."""

    @property
    def processes(self) -> int:
        """How many workers to start: no more than there are episodes; 0 for one per CPU of a cluster.

        Raises:
            InvalidSetup: The number asked for makes no sense.
        """
        if self.workers < 0:
            raise InvalidSetup(f"workers is {self.workers}; valid is 0 (one per core) and more.")
        if self.cluster not in (None, LOCAL):
            return self.workers
        return min(self.workers or os.cpu_count() or 1, max(self.episodes, 1))

    @property
    def cluster(self) -> str | None:
        """Address of the Ray cluster; None for processes without Ray."""
        return self.ray_address or (LOCAL if self.ray else None)


def pose_of(given: Sequence[float]) -> Pose:
    """Return the pose that `--pose` gives as x y z [m], roll pitch yaw [rad].

    Raises:
        InvalidSetup: A number is not finite.
    """
    if not all(map(math.isfinite, given)):
        raise InvalidSetup(f"--pose is {' '.join(map(str, given))}; valid are six finite numbers.")
    return Pose.from_rpy(given[:3], given[3:])


def evaluation_folder(given: Path | None) -> Path:
    """Return a folder for an evaluation that nothing is in, so that none is mixed with another.

    Args:
        given: The folder that is asked for; None for the usual one.

    Raises:
        InvalidSetup: Something is in the folder that is given.
        DatasetError: It cannot be written.
    """
    folder = given or USUAL_FOLDER
    number = 1
    while given is None and os.path.lexists(folder):
        number += 1
        folder = USUAL_FOLDER.with_name(f"{USUAL_FOLDER.name}-{number}")
    if folder.is_dir() and any(folder.iterdir()):
        raise InvalidSetup(f"{folder} is not empty, and an evaluation has a folder of its own. Choose another --out.")
    require_writable(folder)
    return folder


class Interruptible(Protocol):
    """A run that ends after what is at work once it is told to."""

    is_interrupted: bool


class Run(Interruptible, Protocol):
    """A run of episodes."""

    cluster: ClusterUsage | None


def show(
    attempts: Iterable[Attempt], title: str, total: int, console: Console, run: Run, done: Callable[[], int]
) -> None:
    """Go through attempts with a bar that tells how many succeed and how fast they are made.

    Args:
        attempts: Each is made when it is asked for.
        title: What is written before the bar.
        total: How many there shall be in the end.
        console: Where the bar is.
        run: Says where the attempts are made.
        done: Returns how many there are.
    """
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[told]}", markup=False),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    made = Summary()
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(title, total=total, told="")
        start = time.perf_counter()
        try:
            for attempt in attempts:
                made.attempts.append(attempt)
                speed = len(made.attempts) / (time.perf_counter() - start)
                told = f"{_rate(made)}, {speed:.2f} episodes/s"
                if run.cluster is not None and len(run.cluster.machines) > 1:
                    told += f" on {len(run.cluster.machines)} machines"
                bar.update(task, completed=min(done(), total), told=told)
            bar.update(task, completed=min(done(), total))
        except BaseException:
            if not made.attempts:  # an empty bar says nothing: the error stands alone
                bar.live.transient = bar.disable = True
                bar.live.stop()
            raise


def results_table(summary: Summary, seconds: float, workers: int | str | ClusterUsage) -> Table:
    """Return how attempts went, and how fast they were made.

    Args:
        summary: The attempts, at least one.
        seconds: Wall time [s].
        workers: How many processes made them, or where they were made, in words.
    """
    made, steps = len(summary.attempts), sum(result.steps for result in summary.results)
    low, high = (100 * bound for bound in summary.interval)
    interval = f"{summary.successes} of {summary.judged} = {_rate(summary, '')} (95 % Wilson interval {low:.1f} to "
    rate = made / seconds
    speed = f"{made} episodes in {seconds:.1f} s: {rate:.2f}/s, {1200 * rate:.0f} per 20 minutes"
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_row("success", f"{interval}{high:.1f} %)" if summary.judged else "not judged")
    table.add_row("failures", ", ".join(f"{name} {count}" for name, count in summary.failures.most_common()) or "none")
    table.add_row("speed", f"{speed}, {steps / seconds:.0f} steps/s")
    table.add_row("workers", str(workers))
    return table


def _rate(summary: Summary, word: str = " success") -> str:
    return f"{100 * summary.successes / summary.judged:.1f} %{word}" if summary.judged else "not judged"


@contextmanager
def interruptible(run: Interruptible, console: Console, told: str = ENDING) -> Generator[None]:
    """Let the first Ctrl-C end a run, which says so, after what is at work; the second, or SIGTERM, at once."""

    def on_interrupt(number: int, frame: object) -> None:
        if run.is_interrupted:
            raise KeyboardInterrupt
        run.is_interrupted = True
        console.print(told)

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
