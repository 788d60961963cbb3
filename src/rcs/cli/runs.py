"""What commands share: options of an environment; of `rcs collect` and `rcs eval` an agent, a bar and the results."""

from __future__ import annotations

import json
import math
import os
import signal
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Protocol, cast, get_args

import tyro
from rcs_data.output import require_writable
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from tyro.constructors import PrimitiveConstructorSpec

from rcs.agents.choice import is_path
from rcs.envs.reward import RewardKind
from rcs.envs.setup import AtEnd, Setup
from rcs.envs.spaces import Control, Observed
from rcs.errors import InvalidSetup
from rcs.rollout.cluster import LOCAL
from rcs.rollout.collect import Attempt
from rcs.rollout.evaluate import Summary
from rcs.rollout.ray_pool import ClusterUsage
from rcs.setups.lab import lab_of
from rcs.sim.detail import Assets
from rcs.sim.randomisation import Preset, Randomisation
from rcs.sim.world import Stepping
from rcs.spatial import Pose

ENDING = "Ending after the episodes at work; Ctrl-C again ends at once."
"""What is told at the first Ctrl-C."""


USUAL_FOLDER = Path("evaluation")
"""Folder of an evaluation for which none is given; with a number where it is taken."""


def _preset(words: list[str]) -> Preset:
    preset, *more = words or ["default"]
    if more:
        raise ValueError(f"one of {', '.join(PRESETS)} is expected, not {' '.join(words)}")
    return cast(Preset, preset)  # tyro has compared it with the choices


PRESETS: tuple[Preset, ...] = get_args(Preset)
AnyPreset = Annotated[
    Preset,
    PrimitiveConstructorSpec(
        nargs="*",
        metavar=f"[{{{','.join(PRESETS)}}}]",
        instance_from_str=_preset,
        is_instance=lambda preset: preset in PRESETS,
        str_from_instance=lambda preset: [preset],
        choices=PRESETS,
    ),
]
"""An option with the name of a preset, or with none for the usual one."""


@dataclass(kw_only=True)
class SetupOptions:
    """Options of a command that makes an environment."""

    task: tyro.conf.Positional[str]
    """Name of the task, such as PickCuboid, or `module:Class`; or the path of a checkpoint, or of a run, for the
    environment that it was trained in."""
    robot: str = "fr3"
    """Name of the robot."""
    end_effector: str | None = None
    """Name of the end effector; the robot's usual one by default."""
    task_option: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, tyro.conf.arg(metavar="NAME=VALUE")] = ()
    """An option of the task as `name=value`, such as `lift_height=0.05`; may be given several times."""
    reward: RewardKind = "shaped"
    """What a step pays."""
    discount: float = 0.99
    """What a reward one step later is worth to the learner; the shaped and the dense reward depend on it."""
    layers: tuple[str, ...] = ()
    """Names of more layers on top, or `module:Class`, from the lowest to the highest."""
    observe: tuple[Observed, ...] = ()
    """What is observed besides, such as `privileged` poses of objects or `contacts` of the fingers."""
    gates: tuple[str, ...] = ()
    """Names of gates that every target must pass before a device sees it, such as Guard, or `module:Class`."""
    seed: int = 0
    """Same seed, same episodes."""
    cameras: tuple[str, ...] | None = None
    """Cameras; those of the robot's lab when not given, `none` for none."""
    image_size: int = 224
    """Width and height of every frame in pixels."""
    camera_mode: str | None = None
    """Mode of the cameras in the place of the size, such as `848x480`; `rcs list --cameras` has them."""
    camera_fps: float | None = None
    """Frames per second of the cameras; the most that each offers when not given."""
    camera_noise: bool = False
    """Give frames the noise of real cameras."""
    depth: bool = False
    """Frames have depth too."""
    segmentation: bool = False
    """Frames say which instance and which geom each pixel shows."""
    tactile: str | None = None
    """Tactile sensor in the place of the gripper's pads, such as `digit`, which has frames too."""
    control: Control = "joints"
    """What actions say of the arm."""
    absolute: bool = False
    """Absolute actions instead of differences to the last step."""
    native: bool = False
    """Poses and twists go to the controllers of real arms, which lead the TCP by their own laws."""
    frequency: float = 30.0
    """Control steps per second [Hz]."""
    collision_reaction: bool = True
    """Stop an arm that pushes harder than its controller allows, which ends the episode, as on the robot."""
    at_end: AtEnd = "hold"
    """What real arms do in the end: `park` has them go home, slowly."""
    randomise: AnyPreset = "none"
    """Vary looks, objects, physics, start and timing of the robots from episode to episode, within these ranges; those
    of `default` when none are named."""
    assets: Assets = "builtin"
    """Looks of the robots: `menagerie` for detailed meshes, which are slow to draw without a GPU."""

    trust: Annotated[tuple[str, ...], tyro.conf.arg(metavar="[MODULE ...]")] = ()
    """Modules of which the environment of a checkpoint may have classes; importing them runs their code."""

    @property
    def checkpoint(self) -> str | None:
        """Path of the checkpoint, or of the run, whose environment is used; None for one of a task."""
        return self.task if is_path(self.task) else None

    def setup(self, stepping: Stepping = "async") -> Setup:
        """Return the setup that the options ask for; with a checkpoint its own, changed by options that are given.

        Raises:
            InvalidSetup: An option makes no sense, or there is no checkpoint.
            CorruptCheckpoint: The checkpoint is damaged.
            UnknownName: There is no such robot.
        """
        asked: dict[str, dict[str, Any]] = {
            "task_option": {"task_options": dict(option_of_task(given) for given in self.task_option)},
            "cameras": {"cameras": self._cameras()},
            "image_size": {"image_size": (self.image_size, self.image_size)},
            "absolute": {"relative": "absolute" if self.absolute else "last_step"},
            "randomise": {"randomisation": Randomisation.of(self.randomise)},
            **{name: {name: getattr(self, name)} for name in _AS_THEY_ARE},
        }
        if self.checkpoint is None:
            changes = {name: value for one in asked.values() for name, value in one.items()}
            setup = Setup(task=self.task)
        else:
            from rcs.rl.checkpoint import find_checkpoint

            usual = {own.name: own.default for own in fields(type(self))}
            given = [one for name, one in asked.items() if getattr(self, name) != usual[name]]
            changes = {name: value for one in given for name, value in one.items()}
            setup = find_checkpoint(self.checkpoint, trust=self.trust).training.evaluation_setup
        cameras = changes.get("cameras", setup.cameras)
        for name in ("depth", "segmentation"):
            changes[name] = changes.get(name, getattr(setup, name)) and bool(cameras)
        return replace(setup, **changes, stepping=stepping)

    def _cameras(self) -> tuple[str, ...]:
        if self.cameras is None:
            return () if self.checkpoint else tuple(lab_of(self.robot).cameras)
        return () if self.cameras == ("none",) else self.cameras


_AS_THEY_ARE = (
    "reward", "discount", "robot", "end_effector", "layers", "observe", "gates", "camera_mode", "camera_fps",
    "camera_noise", "depth", "segmentation", "tactile", "control", "native", "frequency", "assets",
    "collision_reaction", "at_end",
)  # fmt: skip
"""Options that are fields of a setup."""


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

    def setup(self, stepping: Stepping = "async") -> Setup:
        """Return the setup that the options ask for; see `SetupOptions.setup`.

        Raises:
            InvalidSetup: The agent is a checkpoint of another task.
        """
        setup = super().setup(stepping)
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


def option_of_task(given: str) -> tuple[str, Any]:
    """Return name and value of an option that is written as `name=value`.

    Raises:
        InvalidSetup: It is written in another way.
    """
    name, has_value, value = given.partition("=")
    if not (name and has_value):
        raise InvalidSetup(f"The task option is {given!r}; it is written as name=value, such as lift_height=0.05.")
    try:
        return name, json.loads(value)
    except (ValueError, RecursionError):  # a text need not have quotes
        return name, value


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
