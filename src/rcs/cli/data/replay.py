"""`rcs data replay`: play recorded episodes again and compare."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console
from rich.progress import track

from rcs.data import Dataset
from rcs.rollout.replay import replay


@dataclass(kw_only=True)
class ReplayCommand:
    """Replay every episode in simulation and compare all states bit for bit. Exit code 1 when one differs."""

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""

    def run(self) -> int:
        """Replay and print how many are equal."""
        console = Console(soft_wrap=True)
        total = len(Dataset.open(self.path))
        start = time.perf_counter()
        results = list(track(replay(self.path), "Replaying", total=total, console=console))
        seconds = time.perf_counter() - start
        different = [result for result in results if not result.is_equal]
        for result in different:
            console.print(f"episode {result.episode_id}: state {result.first_difference} differs", highlight=False)
        steps = sum(result.steps for result in results)
        equal = len(results) - len(different)
        console.print(
            f"{equal} of {len(results)} episodes bit-equal ({steps} steps in {seconds:.1f} s)", highlight=False
        )
        return 1 if different else 0
