"""`rcs collect`: a dataset of episodes that an agent makes, with a report page."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rcs_data.cli.console import plain_console
from rcs_data.cli.program import INTERRUPTED
from rcs_data.feature import Colour
from rcs_data.view import write_report
from rich.console import Console

from rcs.cli.runs import RunOptions, interruptible, results_table, show
from rcs.cli.setup_options import flags
from rcs.envs.setup import Setup
from rcs.envs.step.approach import SPEED
from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware.site import Site
from rcs.rollout.collect import Collection, Progress, collect
from rcs.rollout.evaluate import Summary
from rcs.rollout.operator import Operator, TerminalOperator, VirtualOperator, operator_of

if TYPE_CHECKING:
    CollectFlags = Setup
else:
    CollectFlags = flags(cameras="all")


@dataclass(kw_only=True)
class CollectCommand(RunOptions):
    """Collect a dataset of scripted episodes and write a report page.

    Episode i depends only on the seed and on i, so the same command resumes an interrupted collection, and neither the
    number of workers nor a cluster changes the data. Ctrl-C ends after the running episodes; a second one ends at once.

    With `--hardware`, arms are real. Before each episode they go home, slowly, and somebody puts the objects where the
    terminal says; after it, they say whether the task was done. A virtual robot does both by itself.
    """

    environment: Annotated[CollectFlags, tyro.conf.OmitArgPrefixes] = field(default_factory=CollectFlags)
    """The fields of `rcs.Setup` and `rcs.Cameras`, as in Python; but for cameras, which are all, as a dataset is to be
    seen and learned from."""
    episodes: int = 20
    """Number of episodes in the finished dataset; partial episodes left by a kill do not count."""
    out: Path = field(default_factory=lambda: Path("datasets/collected"))
    """Folder of the dataset."""
    only_success: bool = False
    """Keep successful episodes only, and try until there are enough."""
    most_attempts: int | None = None
    """Attempts after which `--only-success` gives up; by default 100 without a single success, else 20 per episode."""
    colour: Colour = "jpeg"
    """Encoding of colour frames. Of the space of `jpeg`, the video `h264` takes a quarter to two fifths and `av1` a
    sixth or less, at some loss of quality and speed; `lossless` takes as much, with sensor noise six times as much."""
    jpeg_quality: int = 95
    """JPEG quality of colour frames."""
    report: bool = True
    """Write report.html."""
    hardware: str | None = None
    """Real devices: the JSON file of a site, or `driver:address` for all arms with their end effectors. Cameras are
    then those of the site, if none are given."""
    yes: bool = False
    """Do not ask whether real arms may go home: somebody watches them."""
    home_speed: float = SPEED
    """Largest speed of a joint of real arms on their way home, as a share of its limit."""
    viewer: bool = False
    """Watch in a window, in real time; needs a display."""

    def run(self) -> int:
        """Collect, print the results and return the exit code."""
        console = plain_console(soft_wrap=False)
        if self.viewer and self.cluster:
            raise InvalidSetup("One watches in this process; use --viewer without --ray and --ray-address.")
        if self.viewer and self.hardware:
            raise InvalidSetup("A real robot has no simulated scene to watch; use --viewer without --hardware.")
        cameras: Any = "all"
        if self.hardware:
            cameras = tuple(Site.read(self.hardware).cameras) if self.hardware.endswith(".json") else ()
        collection = Collection(
            setup=self.setup("realtime" if self.viewer else None, cameras=cameras),
            out=self.out,
            episodes=self.episodes,
            seed=self.seed,
            only_success=self.only_success,
            most_attempts=self.most_attempts,
            agent=self.actor,
            workers=1 if self.viewer or (self.hardware and not self.workers) else self.processes,
            ray=self.cluster,
            colour=self.colour,
            jpeg_quality=self.jpeg_quality,
            hardware=self.hardware,
            home_speed=self.home_speed,
        )
        if self.viewer:
            from rcs.cli.watch import watch_collection

            return watch_collection(collection, console)
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
        operator: Operator | None = None
        if self.hardware is not None:
            operator = operator_of(collection.setup, self.hardware, agrees=self.yes)
        attempts = collect(collection, progress, operator=operator)
        if isinstance(operator, TerminalOperator):
            if not sys.stdin.isatty():
                raise InvalidSetup("The input is no terminal, and a person at a terminal places objects and judges.")
            for attempt in attempts:  # a bar would write over the questions
                told = {True: "done", False: "not done", None: "not known"}[attempt.result.success]
                console.print(f"Episode {attempt.number + 1} of {self.episodes}: {told}")
            return
        if isinstance(operator, VirtualOperator):
            console.print(f"{operator.name} is a virtual robot, which places its objects and judges by itself.")
        title = f"{collection.setup.task} on {collection.setup.robot_label}"
        show(attempts, title, self.episodes, console, progress, lambda: progress.kept)


def _summarise(collection: Collection, progress: Progress, console: Console) -> None:
    if progress.found:
        console.print(f"{progress.found} episodes existed already.")
    if progress.again:
        console.print(f"{progress.again} episodes cut short by a kill were collected again.")
    if progress.attempts:
        summary = Summary(attempts=progress.attempts)
        console.print(results_table(summary, progress.seconds, progress.cluster or collection.workers))
    elif not progress.is_interrupted:
        console.print(f"Nothing to do: {collection.out} has {progress.kept} episodes.", soft_wrap=True)
