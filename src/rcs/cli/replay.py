"""`rcs data replay`: replay recorded episodes in simulation: compare, draw, execute or follow them."""

from __future__ import annotations

import dataclasses
import json
import threading
import time
from dataclasses import dataclass, field
from datetime import timedelta
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro
from numpy.typing import NDArray
from rcs_data import Dataset
from rcs_data.cli.console import plain_console
from rich.console import Console
from rich.progress import Progress, track
from rich.table import Table

from rcs.envs.setup import RelativeTo
from rcs.envs.spaces import Control
from rcs.errors import InvalidSetup
from rcs.rollout.derive import Derivation, derive, row_counter
from rcs.rollout.divergence import Tolerance
from rcs.rollout.look import Look
from rcs.rollout.real_to_sim import Keep, RealToSim, RealToSimResult
from rcs.rollout.recorded_motion import GripperFrom
from rcs.rollout.reexecute import Reexecution, ReexecutionResult
from rcs.rollout.replay import replay
from rcs.rollout.rerender import Rerendering

Kind = Literal["check", "render", "actions", "states"]

JOBS: dict[Kind, type[Derivation]] = {"render": Rerendering, "actions": Reexecution, "states": RealToSim}
"""The kinds that make a dataset, with their jobs; each has the options of its job."""
PATIENCE = 30.0
"""Interval of progress lines where no bar can be drawn [s]."""
WIDTH = 116
"""Width of the widest table [columns]."""


@dataclass(kw_only=True)
class ReplayCommand:
    """Replay every episode in simulation.

    `check` plays the recorded actions and compares all states bit for bit; exit code 1 if one differs. The other kinds
    make a new dataset: `render` restores the recorded states and draws new frames; `actions` executes the recorded
    actions again, in another control mode if given, and measures the divergence; `states` makes a simulated robot
    follow the recorded one, real or not, and keeps the successes.
    """

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    kind: Kind = "check"
    """Kind of replay."""
    out: Path | None = None
    """Folder of the new dataset; not for `check`."""
    workers: int = 0
    """Processes; 0 for one per CPU core."""
    json: bool = False
    """Print JSON instead of a table."""
    trust: tuple[str, ...] = ()
    """Modules that may be imported because the dataset's setup names them, such as `my_tasks`."""
    control: Control | None = None
    """actions: control mode of the new actions; None for the recorded one."""
    relative: RelativeTo | None = None
    """actions: reference of the new actions; None for absolute ones if `control` is given, else for the recorded
    one."""
    grace: float = 1.0
    """actions, states: how long to hold the end if the task is not done yet [s]."""
    task: str | None = None
    """states: the task that judges; None for that of the dataset's setup."""
    robot: str | None = None
    """states: the robot; None for that of the dataset's setup."""
    frequency: float | None = None
    """states: control steps per second of the simulation [Hz]; None for that of the setup."""
    objects: Path | None = None
    """states: JSON file with the objects' poses, {episode: {name: [x, y, z, qx, qy, qz, qw]}} in the base frame; None
    for those in the outcome's `objects`."""
    state: str | None = None
    """states: feature with joints, then gripper or hand, such as `observation/state` in foreign datasets; None for one
    feature each."""
    lookahead: float = 0.0
    """states: lead of targets over the recorded joints [s]."""
    gripper: GripperFrom | None = None
    """states: what grippers follow: whether the recorded opening grows or shrinks (`trend`), the opening itself
    (`opening`), or the recorded command (`command`)."""
    keep: Keep = "successes"
    """states: episodes to keep in the new dataset."""
    look: Look = field(default_factory=Look)
    tolerance: Tolerance = field(default_factory=Tolerance)

    def run(self) -> int:
        """Replay, print the results and return the exit code."""
        self._check_options()
        told = plain_console()
        started = time.perf_counter()
        results = self._replay(plain_console(stderr=True, soft_wrap=False) if self.json else told)
        seconds = time.perf_counter() - started
        if self.json:
            told.out(json.dumps(self._as_json(results, seconds), indent=1))
        else:
            self._tell(results, seconds, told)
        return 1 if self.kind == "check" and not all(result.is_equal for result in results) else 0

    def _check_options(self) -> None:
        if self.kind != "check" and self.out is None:
            raise InvalidSetup(f"--kind {self.kind} makes a dataset; give its folder with --out.")
        valid = {kind: {option.name for option in dataclasses.fields(job)} for kind, job in JOBS.items()}
        for option in dataclasses.fields(self):
            given, default = getattr(self, option.name), _default(option)
            kinds = [kind for kind, names in valid.items() if option.name in names]
            if option.name in ("path", "kind", "json", "trust") or self.kind in kinds or given == default:
                continue
            changed = [option.name]
            if dataclasses.is_dataclass(given):
                parts = [part.name for part in dataclasses.fields(given)]
                changed = [part for part in parts if getattr(given, part) != getattr(default, part)]
            options = ", ".join(f"--{name.replace('_', '-')}" for name in changed)
            raise InvalidSetup(f"{options} has no meaning for --kind {self.kind}; valid for {', '.join(kinds)}.")

    def _replay(self, console: Console) -> list[Any]:
        """Replay all episodes, showing progress and the time left."""
        dataset = Dataset.open(self.path)
        if self.kind == "check":
            return list(track(replay(self.path, trust=self.trust), "Replaying", total=len(dataset), console=console))
        job = JOBS[self.kind]
        options = {
            option.name: getattr(self, option.name) for option in dataclasses.fields(job) if option.name != "source"
        }
        rows = row_counter()
        total = sum(episode.length for episode in dataset.episodes)
        with _Progress(rows, total, console):
            return list(derive(job(source=self.path, **options), rows))

    def _as_json(self, results: list[Any], seconds: float) -> dict[str, Any]:
        values: dict[str, Any] = {"kind": self.kind, "dataset": str(self.path), "seconds": seconds}
        if self.out is not None:
            values["out"] = str(self.out)
        ordered = sorted(results, key=lambda result: result.episode_id)
        if self.kind == "check":
            values["equal"] = sum(result.is_equal for result in ordered)
        elif self.kind != "render":
            values["successes"] = sum(result.success for result in ordered)
        if self.kind == "actions":
            return {**values, "episodes": [result.to_json(with_rows=True) for result in ordered]}
        if self.kind == "states":
            return {**values, "episodes": [result.to_json() for result in ordered]}
        return {**values, "episodes": [dataclasses.asdict(result) for result in ordered]}

    def _tell(self, results: list[Any], seconds: float, console: Console) -> None:
        ordered = sorted(results, key=lambda result: result.episode_id)
        if self.kind == "check":
            for result in ordered:
                if not result.is_equal:
                    why = "" if result.begins_at_reset else "; it does not begin at a reset, as after a trim"
                    console.print(
                        f"episode {result.episode_id}: state {result.first_difference} differs{why}", highlight=False
                    )
            steps, equal = sum(result.steps for result in ordered), sum(result.is_equal for result in ordered)
            told = f"{equal} of {len(ordered)} episodes bit-equal ({steps} steps in {seconds:.1f} s)"
        elif self.kind == "render":
            rows = sum(result.rows for result in ordered)
            told = f"{len(ordered)} episodes drawn ({rows} rows in {seconds:.1f} s, {rows / seconds:.0f}/s)"
        elif self.kind == "actions":
            _print_wide(divergence_table(ordered), console)
            good = sum(result.success for result in ordered)
            within = sum(result.first_beyond is None for result in ordered)
            before = sum(result.recorded_success is True for result in ordered)
            told = f"{good} of {len(ordered)} succeed ({before} as recorded), {within} stay within the tolerance"
        else:
            _print_wide(success_table(ordered), console)
            told = _count(ordered)
        console.print(told)
        if self.out is not None:
            console.print(f"Dataset: {self.out}")


class _Progress(Progress):
    """A bar of the rows that worker processes count; a line now and then where no bar can be drawn."""

    def __init__(self, rows: Synchronized[int], total: int, console: Console) -> None:
        """Watch a count go up to a total."""
        # Episodes differ and computers are shared, so the estimate uses the last minutes.
        super().__init__(console=console, refresh_per_second=2, speed_estimate_period=300.0)
        self._rows = rows
        self._task = self.add_task("Replaying", total=total)
        self._thread = threading.Thread(target=self._watch, name="rcs progress", daemon=True)
        self._is_over = threading.Event()

    def _watch(self) -> None:
        while not self._is_over.wait(0.5 if self.console.is_terminal else PATIENCE):
            self.update(self._task, completed=self._rows.value)
            task = self.tasks[0]
            if not self.console.is_terminal and task.time_remaining is not None:
                left = timedelta(seconds=round(task.time_remaining))
                self.console.print(f"{task.completed:.0f} of {task.total:.0f} rows, about {left} left")

    def start(self) -> None:
        """Show the bar and watch the count."""
        super().start()
        self._thread.start()

    def stop(self) -> None:
        """Stop watching."""
        self._is_over.set()
        self._thread.join()
        self.update(self._task, completed=self._rows.value)
        super().stop()


def _default(option: dataclasses.Field[Any]) -> Any:
    return option.default if option.default_factory is dataclasses.MISSING else option.default_factory()


def _print_wide(table: Table, console: Console) -> None:
    """Print a table in full, even if the terminal is narrow or missing."""
    plain_console(width=max(console.width, WIDTH)).print(table)


def divergence_table(results: list[ReexecutionResult]) -> Table:
    """Return a table with largest and median errors of every episode."""
    table = Table("episode", "steps", "success", "joints [mrad]", "TCP [mm]", "TCP [mrad]", "object [mm]",
                  "object [mrad]", "beyond tolerance", box=None, pad_edge=False)  # fmt: skip
    for result in results:
        first = result.first_beyond
        cells = [
            _largest_and_median(getattr(result.divergence, name))
            for name in ("joints", "position", "rotation", "object_position", "object_rotation")
        ]
        beyond = "never" if first is None else f"row {first[0]}: {first[1].replace('_', ' ')}"
        verdict = _verdict(result.recorded_success, result.success)
        table.add_row(result.episode_id, f"{result.steps}/{result.recorded_steps}", verdict, *cells, beyond)
    table.caption = "max/median over the rows of an episode; steps: made/recorded; success: recorded → replayed"
    return table


def success_table(results: list[RealToSimResult]) -> Table:
    """Return a table with the result of every episode in simulation."""
    table = Table("episode", "steps", "success", "joints [rad]", "problem", box=None, pad_edge=False)
    for result in results:
        error = "-" if result.joint_error is None else f"{result.joint_error[0]:.2g}/{result.joint_error[1]:.2g}"
        verdict = _verdict(result.recorded_success, result.success)
        table.add_row(result.episode_id, str(result.steps), verdict, error, result.problem or "")
    table.caption = "joints: max/median distance from the recording; success: recorded → simulated"
    return table


def _count(results: list[RealToSimResult]) -> str:
    good = sum(result.success for result in results)
    real = [result for result in results if result.recorded_success]
    told = f"{good} of {len(results)} succeed in simulation"
    if 0 < len(real) < len(results):
        told += f"; of {len(real)} recorded successes {sum(result.success for result in real)}"
    problems = sum(result.problem is not None for result in results)
    return told + (f"; {problems} could not be replayed" if problems else "")


def _largest_and_median(values: NDArray[np.float64]) -> str:
    """Return largest and median of values in m or rad, in mm or mrad."""
    return f"{1e3 * values.max():.2f}/{1e3 * np.median(values):.2f}" if len(values) else "-"


def _verdict(before: bool | None, now: bool) -> str:
    words = {True: "yes", False: "no", None: "?"}
    return f"{words[before]} → {words[now]}"
