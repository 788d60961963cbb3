"""`rcs data replay`: replay recorded episodes in simulation: compare, render, execute or follow them."""

from __future__ import annotations

import dataclasses
import inspect
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import tyro
from rcs_data import Dataset
from rcs_data.cli.console import plain_console
from rich.console import Console
from rich.progress import track
from rich.table import Table

from rcs.errors import InvalidSetup
from rcs.rollout.real_to_sim import Keep, real_to_sim
from rcs.rollout.reexecute import ReexecutionResult, reexecute
from rcs.rollout.replay import replay
from rcs.rollout.replay_scene import Appearance
from rcs.rollout.rerender import rerender

Kind = Literal["check", "render", "actions", "states"]

REPLAYS: dict[Kind, Callable[..., Iterator[Any]]] = {
    "check": replay,
    "render": rerender,
    "actions": reexecute,
    "states": real_to_sim,
}
"""What each kind calls, with the options of the command that are its arguments."""
WIDTH = 116
"""Width of the widest table [columns]."""
MILLI = {"joints": "joints [mrad]", "position": "TCP [mm]", "rotation": "TCP [mrad]", "object_position": "object [mm]",
         "object_rotation": "object [mrad]"}  # fmt: skip
"""Heads of the columns of deviations."""


@dataclass(kw_only=True)
class ReplayCommand:
    """Replay every episode in simulation.

    `check` plays the recorded actions and compares all states bit for bit; exit code 1 if one differs. The other kinds
    make a new dataset: `render` restores the recorded states and renders new frames; `actions` executes the recorded
    actions again and measures the deviation; `states` makes a simulated robot follow the recorded one, real or not, and
    keeps the successes.
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
    grace: float = 1.0
    """states: how long to hold the end if the task is not done yet [s]."""
    task: str | None = None
    """states: the task that judges; None for that of the dataset's setup."""
    robot: str | None = None
    """states: the robot; None for that of the dataset's setup."""
    objects: Path | None = None
    """states: JSON file with the objects' poses, {episode: {name: [x, y, z, qx, qy, qz, qw]}} in the base frame; None
    for those in the outcome's `objects`."""
    state: str | None = None
    """states: feature with joints, then gripper or hand, such as `observation/state` in foreign datasets; None for one
    feature each."""
    keep: Keep = "successes"
    """states: episodes to keep in the new dataset."""
    appearance: Appearance = field(default_factory=Appearance)

    def run(self) -> int:
        """Replay, print the results and return the exit code."""
        options = self._options()
        console = plain_console()
        progress = plain_console(stderr=True, soft_wrap=False) if self.json else console
        started = time.perf_counter()
        total = len(Dataset.open(self.path))
        episodes = track(REPLAYS[self.kind](self.path, **options), "Replaying", total=total, console=progress)
        results = sorted(episodes, key=lambda result: result.episode_id)
        seconds = time.perf_counter() - started
        if self.json:
            values = {"kind": self.kind, "dataset": str(self.path), "seconds": seconds}
            console.out(json.dumps({**values, "episodes": [result.to_json() for result in results]}, indent=1))
        else:
            self._print(results, seconds, console)
        return 1 if self.kind == "check" and not all(result.is_equal for result in results) else 0

    def _options(self) -> dict[str, Any]:
        """Return the arguments of this kind of replay.

        Raises:
            InvalidSetup: An option was given that belongs to another kind, or `--out` is missing.
        """
        if self.kind != "check" and self.out is None:
            raise InvalidSetup(f"--kind {self.kind} makes a dataset; give its folder with --out.")
        takes = {kind: set(inspect.signature(function).parameters) for kind, function in REPLAYS.items()}
        for option in dataclasses.fields(self):
            given, default = getattr(self, option.name), _default(option)
            if option.name in ("path", "kind", "json") or option.name in takes[self.kind] or given == default:
                continue
            changed = [option.name]
            if isinstance(given, Appearance):
                parts = [part.name for part in dataclasses.fields(given)]
                changed = [part for part in parts if getattr(given, part) != getattr(default, part)]
            names = ", ".join(f"--{name.replace('_', '-')}" for name in changed)
            kinds = ", ".join(kind for kind, names in takes.items() if option.name in names)
            raise InvalidSetup(f"{names} has no meaning for --kind {self.kind}; valid for {kinds}.")
        return {name: getattr(self, name) for name in takes[self.kind] if name not in ("path", "source")}

    def _print(self, results: Sequence[Any], seconds: float, console: Console) -> None:
        if self.kind == "check":
            for result in results:
                if not result.is_equal:
                    why = "" if result.begins_at_reset else "; it does not begin at a reset, as after a trim"
                    line = f"episode {result.episode_id}: state {result.first_difference} differs{why}"
                    console.print(line, highlight=False)
            steps, equal = sum(result.steps for result in results), sum(result.is_equal for result in results)
            console.print(f"{equal} of {len(results)} episodes bit-equal ({steps} steps in {seconds:.1f} s)")
        elif self.kind == "render":
            rows = sum(result.rows for result in results)
            console.print(f"{len(results)} episodes rendered ({rows} rows in {seconds:.1f} s, {rows / seconds:.0f}/s)")
        else:
            plain_console(width=max(console.width, WIDTH)).print(results_table(results))  # in full
            console.print(summary(results))
        if self.out is not None:
            console.print(f"Dataset: {self.out}")


def results_table(results: Sequence[ReexecutionResult]) -> Table:
    """Return a table with success and deviations of every episode."""
    heads = [head for name, head in MILLI.items() if any(name in result.errors for result in results)]
    names = [name for name, head in MILLI.items() if head in heads]
    table = Table("episode", "steps", "success", *heads, "problem", box=None, pad_edge=False)
    words = {True: "yes", False: "no", None: "?"}
    for result in results:
        errors = result.summary()
        cells = [
            f"{1e3 * errors[name]['max']:.2f}/{1e3 * errors[name]['median']:.2f}" if name in errors else "-"
            for name in names
        ]
        verdict = f"{words[result.recorded_success]} → {words[result.success]}"
        steps = f"{result.steps}/{result.recorded_steps}"
        table.add_row(result.episode_id, steps, verdict, *cells, result.problem or "")
    table.caption = "max/median deviation over the rows; steps: made/recorded; success: recorded → replayed"
    return table


def summary(results: Sequence[ReexecutionResult]) -> str:
    """Return how many episodes succeed in simulation."""
    recorded = [result for result in results if result.recorded_success]
    words = f"{sum(result.success for result in results)} of {len(results)} succeed in simulation"
    if 0 < len(recorded) < len(results):
        words += f"; of {len(recorded)} recorded successes {sum(result.success for result in recorded)}"
    problems = sum(result.problem is not None for result in results)
    return words + (f"; {problems} could not be replayed" if problems else "")


def _default(option: dataclasses.Field[Any]) -> Any:
    return option.default if option.default_factory is dataclasses.MISSING else option.default_factory()
