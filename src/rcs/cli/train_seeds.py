"""`rcs train --seeds`: the same training with several seeds at a time, on a Ray cluster, and one table of all."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from rcs_data.cli.program import INTERRUPTED
from rcs_data.view.charts import short
from rich.console import Console
from rich.live import Live
from rich.table import Table

from rcs.cli.runs import interruptible
from rcs.rl.metrics import METRICS, RATE
from rcs.rl.report import write_report
from rcs.rl.seeds import Trained, run_of, train_seeds
from rcs.rl.train import cpus as own_cpus
from rcs.rl.training import Training
from rcs.rollout.cluster import LOCAL

_TAIL = 65_536
"""Bytes at the end of a run's figures among which its last evaluation is, or was when the table was drawn last."""
_EACH = 2
"""CPUs of a training on machines that are not this one, if nobody says: what the recipes are made for."""


def train_each(
    training: Training,
    seeds: Sequence[int],
    out: Path,
    console: Console,
    *,
    ray_address: str | None,
    threads: int,
    videos: bool,
) -> int:
    """Train with each seed, show how far each is, and return the exit code.

    Args:
        training: What to train, but for the seed.
        seeds: The seeds.
        out: The folder of the runs.
        console: Where to print.
        ray_address: Address of the cluster; None for this machine.
        threads: CPUs of each training; 0 for a share of this machine's, or two of a cluster's.
        videos: Whether each evaluation films an episode.

    Raises:
        MissingDependency: The extra `ray` or `rl` is not installed.
        InvalidSetup: A seed is given twice, or a run of another training is in a folder.
        DatasetError: The disk fails.
    """
    cpus = threads or (max(own_cpus() // max(len(seeds), 1), 1) if ray_address is None else _EACH)
    setup = training.setup
    console.print(
        f"{setup.task} on {setup.robot_label}: {training.algorithm.name}, {training.copies} copies, "
        f"{training.steps} steps; seeds {', '.join(map(str, seeds))}, {cpus} CPUs each. Runs: {out}",
        soft_wrap=True,
    )
    trained: dict[int, Trained] = {}
    latest: dict[int, dict[str, float]] = {seed: {} for seed in seeds}

    def table() -> Table:
        return _table(training, out, latest, trained)

    running = train_seeds(training, seeds, out, ray=ray_address or LOCAL, cpus=cpus, videos=videos)
    live = Live(console=console, get_renderable=table, refresh_per_second=1)
    try:
        with interruptible(_AtOnce(), console), closing(running), live:
            for one in running:
                trained[one.seed] = one
    except KeyboardInterrupt:
        console.print("Ended; the same command goes on from the last checkpoints that are here.")
        return INTERRUPTED
    for seed in seeds:
        console.print(f"Seed {seed}: report {write_report(run_of(out, seed))}", soft_wrap=True)
    console.print(f"Evaluate: rcs eval {run_of(out, seeds[0])} --episodes 300", soft_wrap=True)
    return 0


class _AtOnce:
    """What the first Ctrl-C ends: there are checkpoints already."""

    is_interrupted = True


def _table(training: Training, out: Path, latest: dict[int, dict[str, float]], trained: Mapping[int, Trained]) -> Table:
    """Return how far each seed is, and update `latest` from what is written in its folder."""
    table = Table("seed", "steps", "success", "", box=None)
    for seed, known in latest.items():
        known.update(_last_figures(run_of(out, seed)))
        steps = trained[seed].steps if seed in trained else known.get("steps", 0)
        success = f"{100 * known[RATE]:.0f} %" if RATE in known else "-"
        state = f"done in {trained[seed].seconds / 60:.0f} min" if seed in trained else ""
        table.add_row(str(seed), f"{short(int(steps))}/{short(training.steps)}", success, state)
    return table


def _last_figures(run: Path) -> dict[str, float]:
    """Return the steps of a run and its last evaluation; nothing where it is not on this machine."""
    try:
        with (run / METRICS).open("rb") as file:
            file.seek(max(file.seek(0, 2) - _TAIL, 0))
            lines = file.read().split(b"\n")
    except OSError:
        return {}
    found: dict[str, float] = {}
    for line in lines:
        try:
            row: Any = json.loads(line)
            found["steps"] = float(row["steps"])
            found.update({name: float(value) for name, value in row["figures"].items() if name == RATE})
        except (ValueError, KeyError, TypeError, AttributeError):
            continue  # the first line begins before, the last may not be whole
    return found
