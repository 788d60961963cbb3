"""`rcs data replay`: replay recorded episodes in simulation: compare, render, execute or follow them."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rcs_data import Dataset
from rcs_data.cli.console import plain_console
from rich.console import Console
from rich.progress import track
from rich.table import Table

from rcs.cli.setup_options import changed, flags, given
from rcs.envs.setup import Setup
from rcs.errors import InvalidSetup
from rcs.rollout.recorded_setup import setup_of
from rcs.rollout.reexecute import ReexecutionResult, reexecute
from rcs.rollout.replay import replay
from rcs.rollout.rerender import rerender
from rcs.setups.resolve import with_camera_names

if TYPE_CHECKING:
    ReplayFlags = Setup
else:
    ReplayFlags = flags("as recorded")

Kind = Literal["check", "render", "actions", "states"]
_OF_ACTIONS = {"looks_seed", "only_success"}
OPTIONS: dict[Kind, set[str]] = {
    "check": set(),
    "render": {"looks_seed"},
    "actions": _OF_ACTIONS,
    "states": {*_OF_ACTIONS, "task", "grace"},
}
"""Options that only some kinds have."""
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
    actions again and measures the deviation; `states` makes a simulated robot follow the recorded one, real or not.
    """

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    kind: Kind = "check"
    """Kind of replay."""
    out: Path | None = None
    """Folder of the new dataset; not for `check`."""
    workers: int = 0
    """Processes; 0 for one per CPU core. Not for `check`."""
    json: bool = False
    """Print JSON instead of a table."""
    trust: Annotated[tuple[str, ...], tyro.conf.arg(metavar="[MODULE ...]")] = ()
    """Modules that may be imported because the dataset's setup names them, such as `my_tasks`."""
    environment: Annotated[ReplayFlags, tyro.conf.OmitArgPrefixes] = field(default_factory=ReplayFlags)
    """The fields of `rcs.Setup` and `rcs.Cameras`, as in Python. `render` and `actions` take those of cameras, quality,
    assets and randomisation, of which only what is seen changes; `states` takes all."""
    looks_seed: int | None = None
    """Randomise lights, colours, textures and camera poses with this seed; different seeds make variants."""
    only_success: bool = False
    """actions, states: keep successful episodes only."""
    task: str | None = None
    """states: the task that judges; None for that of the dataset's setup."""
    grace: float = 1.0
    """states: how long to hold the end if the task is not done yet [s]."""

    def run(self) -> int:
        """Replay, print the results and return the exit code."""
        episodes = self._episodes()
        console = plain_console()
        progress = plain_console(stderr=True, soft_wrap=False) if self.json else console
        started = time.perf_counter()
        total = len(Dataset.open(self.path))
        tracked = track(episodes, "Replaying", total=total, console=progress)
        results = sorted(tracked, key=lambda result: result.episode_id)
        seconds = time.perf_counter() - started
        if self.json:
            values = {"kind": self.kind, "dataset": str(self.path), "seconds": seconds}
            console.out(json.dumps({**values, "episodes": [result.to_json() for result in results]}, indent=1))
        else:
            self._print(results, seconds, console)
        return 1 if self.kind == "check" and not all(result.is_equal for result in results) else 0

    def _episodes(self) -> Iterator[Any]:
        """Begin the replay.

        Raises:
            InvalidSetup: An option was given that belongs to another kind, or `--out` is missing.
        """
        chosen = {name: getattr(self, name) for name in OPTIONS["states"]}
        chosen = {name: value for name, value in chosen.items() if value != getattr(ReplayCommand, name)}
        wrong = [*(chosen.keys() - OPTIONS[self.kind]), *(given(self.environment) if self.kind == "check" else ())]
        wrong += [name for name in ("out", "workers") if self.kind == "check" and getattr(self, name)]
        if wrong:
            names = ", ".join(f"--{name.replace('_', '-')}" for name in wrong)
            raise InvalidSetup(f"{names} has no meaning for --kind {self.kind}; see `rcs data replay --help`.")
        if self.kind == "check":
            return replay(self.path, trust=self.trust)
        if self.out is None:
            raise InvalidSetup(f"--kind {self.kind} makes a dataset; give its folder with --out.")
        chosen.pop("task", None)
        more: dict[str, Any] = {**chosen, "setup": self._setup(), "workers": self.workers, "trust": self.trust}
        if self.kind == "render":
            return rerender(self.path, self.out, **more)
        return reexecute(self.path, self.out, kind=self.kind, **more)

    def _setup(self) -> Setup | None:
        """Return the setup that the options ask for; None for the recorded one."""
        options = given(self.environment)
        if not options and self.task is None:
            return None
        dataset = Dataset.open(self.path)
        try:
            setup = setup_of(dataset, trust=self.trust, task=self.task)
        except InvalidSetup:
            if self.kind != "states" or self.task is None or "robot" not in options:
                raise
            setup = Setup(task=self.task, frequency=dataset.info.frequency)  # of a dataset that is not ours
        return with_camera_names(changed(setup, options))

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
            plain_console(width=max(console.width, WIDTH)).print(deviations_table(results))  # in full
            console.print(successes_in_words(results))
        if self.out is not None:
            console.print(f"Dataset: {self.out}")


def deviations_table(results: Sequence[ReexecutionResult]) -> Table:
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


def successes_in_words(results: Sequence[ReexecutionResult]) -> str:
    """Return how many episodes succeed in simulation."""
    recorded = [result for result in results if result.recorded_success]
    words = f"{sum(result.success for result in results)} of {len(results)} succeed in simulation"
    if 0 < len(recorded) < len(results):
        words += f"; of {len(recorded)} recorded successes {sum(result.success for result in recorded)}"
    problems = sum(result.problem is not None for result in results)
    return words + (f"; {problems} could not be replayed" if problems else "")
