"""`rcs train`: a policy by reinforcement learning, with checkpoints, evaluations and a report page."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rcs_data import Dataset
from rcs_data.cli.console import plain_console
from rcs_data.cli.convert import ExportCommand
from rcs_data.cli.program import INTERRUPTED
from rcs_data.convert.options import ExportOptions
from rcs_data.convert.recipe.recipe import LerobotPolicy
from rcs_data.convert.recipe.recipe import recipe as lerobot_recipe
from rcs_data.read.verdicts import wilson_interval
from rcs_data.view.charts import short
from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn
from rich.text import Text

from rcs.cli.runs import interruptible
from rcs.cli.setup_options import changed, flags, given
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.rl.checkpoint import Score, read_training
from rcs.rl.recipes import RECIPES, recipe_for
from rcs.rl.report import write_report
from rcs.rl.train import TrainingProgress, require_trainable, train
from rcs.rl.training import AlgorithmName, Course, Training
from rcs.setups.lab import lab_of
from rcs.setups.resolve import with_camera_names

if TYPE_CHECKING:
    TrainFlags = Setup
else:
    TrainFlags = flags("the recipe's", robot="fr3")

SOURCE = "source.json"
"""File in the folder of an imitation: the policy, and the dataset that it learns from."""
LEROBOT_PROGRAM = "vlagents.policies.lerobot_train"
"""Module that trains in LeRobot's environment."""


@dataclass(kw_only=True)
class TrainCommand:
    """Train a policy by reinforcement learning and write a report page; with `--policy`, by imitation of a dataset.

    Options that are not given are those of the task's recipe. The same command, or `--resume`, goes on with a training
    that was killed, from its last checkpoint, and ends with the same weights. Ctrl-C ends after the running update,
    with a checkpoint; a second one at once. `rcs eval RUN` evaluates what was learned.
    """

    task: Annotated[str, tyro.conf.Positional] = ""
    """Name of the task, such as PickCuboid, or `module:Class`."""
    algorithm: AlgorithmName = "ppo"
    """Algorithm that learns."""
    out: Path | None = None
    """Folder of the run; by default `runs/TASK-ROBOT-ALGORITHM-SEED`."""
    resume: Path | None = None
    """Folder of a run to go on with, in place of a task; other options are then those of its beginning."""
    steps: int | None = None
    """Environment steps of the whole training, of all copies together."""
    copies: int | None = None
    """Copies of the environment that are stepped together."""
    environment: Annotated[TrainFlags, tyro.conf.OmitArgPrefixes] = field(default_factory=TrainFlags)
    """The fields of `rcs.Setup` and `rcs.Cameras`, as in Python; those not given are the recipe's. A policy with
    cameras does not observe where the objects are. With another control than the recipe's, its layers are left out."""
    learning_rate: float | None = None
    """Step size of the learner at the start."""
    course: Annotated[Course, tyro.conf.OmitArgPrefixes] = field(default_factory=Course)
    video: bool = True
    """Film an episode at every evaluation, for the report."""
    threads: int = 0
    """Threads for physics and drawing; 0 for one per CPU. They change no result."""
    trust: Annotated[tuple[str, ...], tyro.conf.arg(metavar="[MODULE ...]")] = ()
    """Modules of which the environment of `--resume` may have classes; importing them runs their code."""
    policy: LerobotPolicy | None = None
    """In place of a task: a policy that LeRobot trains on `--dataset`, in an environment of its own."""
    dataset: Path | None = None
    """With `--policy`: the dataset that it learns from."""
    lerobot_environment: Annotated[Path | None, tyro.conf.arg(name="environment")] = None
    """With `--policy`: the folder of LeRobot's environment, as `vlagents recipe lerobot` makes it."""
    state: tuple[str, ...] | None = None
    """With `--policy`: the features that it receives, as for `rcs data export`; joints and grippers if left out."""
    lerobot: Annotated[tuple[str, ...], tyro.conf.arg(metavar="[NAME=VALUE ...]")] = ()
    """With `--policy`: LeRobot's own options as NAME=VALUE, such as `batch_size=64`."""

    def run(self) -> int:
        """Train, print the results and return the exit code."""
        console, progress = plain_console(soft_wrap=False), TrainingProgress()
        if self.policy is not None:
            return self._imitate(self.policy, console)
        if self.dataset or self.lerobot_environment or self.state or self.lerobot:
            raise InvalidSetup("--dataset, --environment, --state and --lerobot belong to --policy; give one.")
        training, out = self._training()
        try:
            text = "Ending after the running update; press Ctrl-C again to end at once."
            with interruptible(progress, console, text):
                _show(training, out, progress, console, self.threads, self.video)
        finally:
            if progress.steps:
                _summarise(progress, out, console)
        return INTERRUPTED if progress.is_interrupted and progress.steps < training.steps else 0

    def _imitate(self, policy: LerobotPolicy, console: Console) -> int:
        """Export the dataset, write the recipe, run LeRobot, and say how the policy is served; the same again goes on.

        Raises:
            InvalidSetup: An option is missing or of no use, there is no such environment, or the run began with another
                dataset.
        """
        path, environment = self._ingredients()
        python = environment / "bin" / "python"
        if not os.access(python, os.X_OK):
            raise InvalidSetup(
                f"There is no {python}. LeRobot needs an environment of its own: "
                f"vlagents recipe lerobot | sh -s -- {environment}"
            )
        dataset, options = Dataset.open(path), ExportOptions(state=self.state)
        out = self.out or Path("runs", f"{path.resolve().name}-{policy}-{self.course.seed}")
        made = lerobot_recipe(policy, dataset, options)
        state = None if self.state is None else [*self.state]
        source = {"policy": policy, "digest": dataset.digest(), "state": state}
        _check_source(out, source)
        if not (out / "export").exists():
            ExportCommand(path=path, out=out / "export", format=made.export_format, more=options).run()
        made.write(out / "recipe")
        (out / SOURCE).write_text(json.dumps(source, indent=2) + "\n", encoding="utf-8")
        run = out / "run"
        steps = () if self.steps is None else (f"--steps={self.steps}",)
        more = (f"--seed={self.course.seed}", *steps, *(f"--{option}" for option in self.lerobot))
        words = [python, "-m", LEROBOT_PROGRAM, out / "recipe" / "lerobot.json", out / "export", run, *more]
        code = subprocess.run(words, check=False).returncode
        if code:
            console.print(
                f"LeRobot ended with {code}; the same command goes on from its last checkpoint.", soft_wrap=True
            )
            return code
        settings = out / "recipe" / "vlagents.json"
        serve = f"{environment}/bin/vlagents serve {policy} --checkpoint {run} --settings {settings}"
        console.print(f"Serve: {serve}", soft_wrap=True)
        return 0

    def _ingredients(self) -> tuple[Path, Path]:
        """Return the dataset of an imitation and LeRobot's environment, when no option is of another training."""
        if self.dataset is None or self.lerobot_environment is None:
            raise InvalidSetup(
                "--policy learns from a dataset, in LeRobot's environment: give --dataset and --environment, a folder "
                "that `vlagents recipe lerobot | sh -s -- FOLDER` has made."
            )
        if self.task or self.resume is not None:
            raise InvalidSetup("With --policy, give no task or --resume; the same command goes on with a run.")
        usual = vars(Course(seed=self.course.seed))
        if ignored := [
            *given(self.environment),
            *(name for name in ("learning_rate", "copies") if getattr(self, name) is not None),
            *(name for name, value in vars(self.course).items() if value != usual[name]),
        ]:
            raise InvalidSetup(
                f"{', '.join(ignored)} cannot be combined with policy: LeRobot trains it. Its own options are given by "
                "--lerobot, such as batch_size=64."
            )
        return self.dataset, self.lerobot_environment

    def _training(self) -> tuple[Training, Path]:
        if self.resume is not None:
            if self.task or self.out is not None:
                raise InvalidSetup("With --resume, give neither a task nor --out: the run's folder says both.")
            training = read_training(self.resume, trust=self.trust)
            return training if self.steps is None else replace(training, steps=self.steps), self.resume
        if not self.task:
            raise InvalidSetup("Give a task, such as `rcs train PickCuboid`, or a run to go on with: --resume RUN.")
        recipe = self._recipe()
        rate = {} if self.learning_rate is None else {"learning_rate": self.learning_rate}
        setup = self._setup(recipe.setup)
        training = replace(
            recipe,
            setup=setup,
            copies=recipe.copies if self.copies is None else self.copies,
            steps=recipe.steps if self.steps is None else self.steps,
            algorithm=replace(recipe.algorithm, **rate),
            evaluation_steps=recipe.evaluation_steps if "max_episode_steps" not in given(self.environment) else 0,
            **vars(self.course),
        )
        name = self.task.replace(":", ".").replace(os.sep, ".")
        run = f"{name}-{setup.robot_label}-{self.algorithm}-{self.course.seed}"
        return training, self.out or Path("runs", run)

    def _recipe(self) -> Training:
        """Return the recipe, whose teacher and cameras nobody named: it is said where they come from.

        Raises:
            InvalidSetup: Its teacher is of another task, or the robot's lab lacks its cameras.
        """
        recipe = recipe_for(self.task, self.algorithm, cameras=self._cameras)
        if hasattr(recipe.algorithm, "teacher") and (self.task, self.algorithm) not in RECIPES:
            known = ", ".join(task for task, algorithm in RECIPES if algorithm == self.algorithm)
            raise InvalidSetup(
                f"{self.algorithm!r} needs a teacher, and has one for {known}, not for {self.task!r}. Choose one of "
                "these, or `--algorithm ppo`; rcs.rl takes teachers of your own."
            )
        lab, names = lab_of(self._robot).cameras, recipe.setup.cameras.names
        if not self._cameras and not set(names) <= {*lab}:
            raise InvalidSetup(
                f"The recipe of {self.algorithm!r} sees {' and '.join(names)}, cameras that the lab of {self._robot!r} "
                f"lacks; it has {', '.join(lab)}. Choose with --cameras."
            )
        return recipe

    @property
    def _robot(self) -> str:
        return given(self.environment).get("robot", "fr3")

    @property
    def _cameras(self) -> tuple[str, ...]:
        return with_camera_names(changed(Setup(robot=self._robot), given(self.environment))).cameras.names

    def _setup(self, setup: Setup) -> Setup:
        options = {"robot": self._robot, **given(self.environment)}
        if options.get("control", setup.control) != setup.control:
            options = {"layers": (), **options}
        return with_camera_names(changed(setup, options))


def _check_source(out: Path, source: Mapping[str, object]) -> None:
    if not (out / SOURCE).exists():
        return
    before = json.loads((out / SOURCE).read_text(encoding="utf-8"))
    if changed := sorted(key for key in source if before.get(key) != source[key]):
        raise InvalidSetup(
            f"{out} is a run with another {' and '.join(changed)} ('digest' is the dataset's); take another --out."
        )


class _TimeLeft(ProgressColumn):
    """Time that is left, from the steps of this process alone: those before a kill were not made now."""

    def render(self, task: Task) -> Text:
        """Return it as text."""
        left = (task.total or 0) - task.completed
        speed = task.fields["speed"]
        if not speed:
            return Text("-:--:-- left")
        minutes, seconds = divmod(round(left / speed), 60)
        return Text(f"{minutes // 60}:{minutes % 60:02}:{seconds:02} left")


def _show(
    training: Training, out: Path, progress: TrainingProgress, console: Console, threads: int, videos: bool
) -> None:
    setup = training.setup
    require_trainable(training)
    console.print(
        f"{setup.task} on {setup.robot_label}: {training.algorithm.name}, {training.copies} copies, "
        f"{training.steps} steps, seed {training.seed}; {', '.join(setup.cameras.names) or 'no cameras'}. Run: {out}",
        soft_wrap=True,
    )
    columns = (
        TextColumn("{task.fields[doing]:10}"),
        BarColumn(bar_width=12),
        TextColumn("{task.fields[made]} steps, {task.fields[speed]:.0f}/s"),
        TextColumn("{task.fields[text]}"),
        _TimeLeft(),
    )
    noted, scored = 0, progress.score
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("", total=training.steps, doing=progress.doing, speed=0.0, made="", text="")
        for _ in train(training, out, progress, threads=threads, videos=videos):
            for note in progress.notes[noted:]:
                console.print(note, soft_wrap=True)
            noted = len(progress.notes)
            text = "" if progress.score is None else f"success {_rate(progress.score)}"
            done = min(progress.steps, training.steps)
            made = f"{short(progress.steps)}/{short(training.steps)}"
            bar.update(task, completed=done, doing=progress.doing, speed=progress.speed, made=made, text=text)
            if progress.score is not scored:
                scored = progress.score
                write_report(out)
    for note in progress.notes[noted:]:
        console.print(note, soft_wrap=True)


def _summarise(progress: TrainingProgress, out: Path, console: Console) -> None:
    minutes, seconds = divmod(round(progress.seconds), 60)
    console.print(f"{progress.steps} steps in {minutes} min {seconds} s.", soft_wrap=True)
    if progress.best is not None and progress.best.score is not None:
        text = _rate(progress.best.score)
        console.print(f"Best: {progress.best.path}, success {text}", soft_wrap=True)
    console.print(f"Report: {write_report(out)}", soft_wrap=True)
    console.print(f"Evaluate: rcs eval {out} --episodes 300 --videos 10", soft_wrap=True)


def _rate(score: Score) -> str:
    if not score.judged:
        return "not judged"
    low, high = (100 * bound for bound in wilson_interval(score.successes, score.judged))
    rate = 100 * score.successes / score.judged
    return f"{score.successes}/{score.judged} = {rate:.0f} % ({low:.0f} to {high:.0f} %)"
