"""`rcs collect`: a dataset of scripted episodes, with a report page."""

from __future__ import annotations

import os
import signal
import time
from collections import Counter
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from rcs.cli.console import plain_console
from rcs.data.verdicts import wilson_interval
from rcs.data.view import write_report
from rcs.envs.observers.recorder import Colour
from rcs.envs.setup import Setup
from rcs.envs.spaces import Control
from rcs.errors import InvalidSetup
from rcs.rollout.collect import Collection, collect
from rcs.rollout.collect import Progress as CollectionProgress
from rcs.setups.lab import lab_of
from rcs.sim.detail import Assets
from rcs.sim.randomisation import Randomisation

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""


@dataclass(kw_only=True)
class CollectCommand:
    """Collect a dataset of scripted episodes and write a report page.

    Episode i depends only on the seed and on i, so the same command resumes an interrupted collection, and the number
    of workers does not change the data. Ctrl-C ends after the running episodes; a second one ends at once.
    """

    task: tyro.conf.Positional[str]
    """Name of the task, such as PickCuboid, or `module:Class`."""
    agent: str | None = None
    """Name of the agent, or `module:Class` to be called with the environment; default: the task's expert."""
    end_effector: str | None = None
    """Name of the end effector; default: the robot's usual one."""
    robot: str = "fr3"
    """Name of the robot."""
    episodes: int = 20
    """Number of episodes in the finished dataset; partial episodes left by a kill do not count."""
    out: Path = field(default_factory=lambda: Path("datasets/collected"))
    """Folder of the dataset."""
    seed: int = 0
    """Same seed, same data."""
    cameras: tuple[str, ...] | None = None
    """Cameras to record; default: those of the robot's lab, `none` for none."""
    image_size: int = 224
    """Width and height of every frame in pixels."""
    camera_mode: str | None = None
    """Mode of the cameras instead of a size, such as `848x480`; see `rcs list --cameras`."""
    camera_fps: float | None = None
    """Frames per second of the cameras; default: each camera's highest rate."""
    depth: bool = False
    """Record depth too."""
    tactile: str | None = None
    """Tactile sensor to record and to mount instead of the gripper's pads, such as `digit`."""
    control: Control = "joints"
    """What an arm's action is: joints or a pose."""
    absolute: bool = False
    """Use absolute actions instead of differences to the last step."""
    randomise: bool = False
    """Vary lights, colours, textures, cameras, objects, friction and damping from episode to episode."""
    workers: int = 0
    """Processes; 0 for one per CPU core."""
    only_success: bool = False
    """Keep successful episodes only, and try until there are enough."""
    colour: Colour = "jpeg"
    """Encoding of colour frames; `lossless` takes about four times the space."""
    jpeg_quality: int = 95
    """JPEG quality of colour frames."""
    camera_noise: bool = False
    """Give frames the noise of real cameras."""
    assets: Assets = "builtin"
    """Looks of the robots: `menagerie` for detailed meshes, which are slow to draw without a GPU."""
    report: bool = True
    """Write report.html."""
    viewer: bool = False
    """Watch in a window, in real time; needs a display."""

    def run(self) -> int:
        """Collect, print the results and return the exit code."""
        console = plain_console(soft_wrap=False)
        collection = self._collection()
        if self.viewer:
            from rcs.cli.watch import watch_collection

            return watch_collection(collection, console)
        started = time.perf_counter()
        progress = CollectionProgress()
        with _interruptible(progress, console):
            for _ in self._show(collection, progress, console):
                pass
        _summarise(collection, progress, console)
        if self.report and progress.kept:
            page = write_report(collection.out, wall_time=progress.seconds or None)
            console.print(f"Report: {page}", soft_wrap=True)
        console.print(f"Dataset: {collection.out}   ({time.perf_counter() - started:.1f} s in all)", soft_wrap=True)
        return INTERRUPTED if progress.is_interrupted else 0

    def _collection(self) -> Collection:
        if not isinstance(self.workers, int) or self.workers < 0:
            raise InvalidSetup(f"workers is {self.workers}; valid is 0 (one per core) and more.")
        cameras = tuple(lab_of(self.robot).cameras) if self.cameras is None else self.cameras
        cameras = () if cameras == ("none",) else cameras
        setup = Setup(
            task=self.task,
            robot=self.robot,
            end_effector=self.end_effector,
            cameras=cameras,
            image_size=(self.image_size, self.image_size),
            camera_mode=self.camera_mode,
            camera_fps=self.camera_fps,
            depth=self.depth and bool(cameras),
            camera_noise=self.camera_noise,
            assets=self.assets,
            tactile=self.tactile,
            control=self.control,
            relative="absolute" if self.absolute else "last_step",
            stepping="realtime" if self.viewer else "async",
            randomisation=Randomisation() if self.randomise else None,
        )
        workers = 1 if self.viewer else min(self.workers or os.cpu_count() or 1, max(self.episodes, 1))
        return Collection(
            setup=setup,
            out=self.out,
            episodes=self.episodes,
            seed=self.seed,
            only_success=self.only_success,
            agent=self.agent,
            workers=workers,
            colour=self.colour,
            jpeg_quality=self.jpeg_quality,
        )

    def _show(self, collection: Collection, progress: CollectionProgress, console: Console) -> Iterator[Any]:
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}", markup=False),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=console) as bar:
            task = bar.add_task(f"{self.task} on {self.robot}", total=collection.episodes, rate="")
            start = time.perf_counter()
            for attempt in collect(collection, progress):
                rate = len(progress.attempts) / (time.perf_counter() - start)
                good = sum(bool(made.result.success) for made in progress.attempts)
                told = f"{100 * good / len(progress.attempts):.1f} % success, {rate:.2f} episodes/s"
                bar.update(task, completed=min(progress.kept, collection.episodes), rate=told)
                yield attempt
            bar.update(task, completed=progress.kept)


@contextmanager
def _interruptible(progress: CollectionProgress, console: Console) -> Generator[None]:
    """Let the first Ctrl-C end the collection after the running episodes; the second, or SIGTERM, at once."""

    def on_interrupt(number: int, frame: object) -> None:
        if progress.is_interrupted:
            raise KeyboardInterrupt
        progress.is_interrupted = True
        console.print("Ending after the running episodes; Ctrl-C again ends at once.")

    def on_termination(number: int, frame: object) -> None:
        raise KeyboardInterrupt  # the sender will not wait for long: close everything, and end

    before = {
        signal.SIGINT: signal.signal(signal.SIGINT, on_interrupt),
        signal.SIGTERM: signal.signal(signal.SIGTERM, on_termination),
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _summarise(collection: Collection, progress: CollectionProgress, console: Console) -> None:
    made = len(progress.attempts)
    if progress.found:
        console.print(f"{progress.found} episodes existed already.")
    if progress.again:
        console.print(f"{progress.again} episodes cut short by a kill were collected again.")
    if not made:
        console.print(f"Nothing to do: {collection.out} has {progress.kept} episodes.", soft_wrap=True)
        return
    good = sum(bool(attempt.result.success) for attempt in progress.attempts)
    low, high = wilson_interval(good, made)
    failures = Counter(attempt.result.failure for attempt in progress.attempts if not attempt.result.success)
    steps = sum(attempt.result.steps for attempt in progress.attempts)
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_row(
        "success",
        f"{good} of {made} = {100 * good / made:.1f} % (95 % Wilson interval {100 * low:.1f} to {100 * high:.1f} %)",
    )
    table.add_row("failures", ", ".join(f"{name} {count}" for name, count in failures.most_common()) or "none")
    rate = made / progress.seconds
    speed = f"{made} episodes in {progress.seconds:.1f} s: {rate:.2f}/s, {1200 * rate:.0f} per 20 minutes"
    table.add_row("speed", f"{speed}, {steps / progress.seconds:.0f} steps/s")
    table.add_row("workers", str(collection.workers))
    console.print(table)
