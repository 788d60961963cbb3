"""`rcs eval`: how often an agent succeeds."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from rcs.cli.console import plain_console
from rcs.envs.setup import Setup
from rcs.envs.spaces import Control
from rcs.errors import InvalidSetup
from rcs.rollout.evaluate import Evaluation, Summary, evaluate


@dataclass(kw_only=True)
class EvalCommand:
    """Run an agent in seeded episodes and show how often it succeeds."""

    task: Annotated[str, tyro.conf.Positional]
    """Name of the task, or `module:Class`."""
    robot: str = "fr3"
    """Name of the robot."""
    agent: str | None = None
    """Name of the agent, or `module:Class` to be called with the environment; default: the task's expert."""
    episodes: int = 50
    """Number of episodes."""
    seed: int = 0
    """Same seed, same episodes."""
    workers: int = 0
    """Processes; 0 for one per core."""
    end_effector: str | None = None
    """Name of the end effector; default: the robot's usual one."""
    cameras: tuple[str, ...] = ()
    """Cameras that the agent sees."""
    image_size: int = 224
    """Width and height of frames [px]."""
    control: Control = "joints"
    """What an arm's action is: joints or a pose."""
    absolute: bool = False
    """Use absolute actions instead of differences to the last step."""
    frequency: float = 30.0
    """Control steps per second [Hz]."""
    video: bool = False
    """Write videos of the first episodes."""
    video_episodes: int = 10
    """Number of episodes with a video."""
    out: Path = Path("evaluation")
    """Folder for the figures and the videos."""

    def run(self) -> int:
        """Evaluate, print the results and return the exit code."""
        if self.workers < 0:
            raise InvalidSetup(f"workers is {self.workers}; valid is 0 (one per core) and more.")
        setup = Setup(
            task=self.task,
            robot=self.robot,
            end_effector=self.end_effector,
            cameras=self.cameras,
            image_size=(self.image_size, self.image_size),
            control=self.control,
            relative="absolute" if self.absolute else "last_step",
            frequency=self.frequency,
        )
        evaluation = Evaluation(
            setup=setup,
            agent=self.agent,
            episodes=self.episodes,
            seed=self.seed,
            workers=min(self.workers or os.cpu_count() or 1, max(self.episodes, 1)),
            videos=self.out if self.video else None,
            video_episodes=self.video_episodes,
        )
        console, summary = plain_console(), Summary()
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[told]}", markup=False),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        try:
            with Progress(*columns, console=console) as bar:
                task = bar.add_task(f"{self.task} on {self.robot}", total=self.episodes, told="")
                for done, _ in enumerate(evaluate(evaluation, summary), start=1):
                    bar.update(task, completed=done, told=_rate(summary))
        finally:
            if summary.results:
                self.out.mkdir(parents=True, exist_ok=True)
                summary.write(self.out / "evaluation.json", evaluation)
                failures = ", ".join(f"{name} {count}" for name, count in summary.failures.most_common()) or "none"
                low, high = summary.interval
                interval = f" (95 % Wilson interval {100 * low:.1f} to {100 * high:.1f} %)" if summary.judged else ""
                console.print(f"success   {summary.successes} of {summary.judged}: {_rate(summary)}{interval}")
                console.print(f"failures  {failures}")
                console.print(f"Figures: {self.out / 'evaluation.json'}", soft_wrap=True)
                if self.video:
                    console.print(f"Videos: {self.out}", soft_wrap=True)
        return 0


def _rate(summary: Summary) -> str:
    return f"{100 * summary.successes / summary.judged:.1f} % success" if summary.judged else "not judged"
