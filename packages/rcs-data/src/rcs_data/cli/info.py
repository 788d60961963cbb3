"""`rcs-data info`: show the contents of a dataset."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.table import Table

from rcs_data import Dataset
from rcs_data.cli.console import plain_console
from rcs_data.verdicts import Verdicts


@dataclass(kw_only=True)
class InfoCommand:
    """Show the contents of a dataset."""

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""

    def run(self) -> int:
        """Print it."""
        console = plain_console()
        dataset = Dataset.open(self.path)
        episodes = dataset.episodes
        verdicts = Verdicts.of(episode.success for episode in episodes)
        steps = sum(episode.length for episode in episodes)
        failures = Counter(episode.failure or "not classified" for episode in episodes if episode.success is False)
        table = Table(show_header=False, box=None, pad_edge=False)
        table.add_row("dataset", str(dataset.path))
        table.add_row("instruction", dataset.info.instruction)
        table.add_row("episodes", str(len(episodes)))
        table.add_row("success", str(verdicts))
        if verdicts.judged and verdicts.not_judged:
            table.add_row("not judged", str(verdicts.not_judged))
        if verdicts.judged:
            table.add_row("failures", ", ".join(f"{name} {count}" for name, count in failures.most_common()) or "none")
        rate = dataset.info.frequency
        table.add_row("rows", f"{steps} at {rate:g} Hz = {steps / rate / 60:.1f} min")
        table.add_row("content", f"sha256 {dataset.digest()}")
        console.print(table)
        features = Table("feature", "shape", "dtype", "unit", "stored as", box=None, pad_edge=False)
        for feature in dataset.info.features:
            features.add_row(feature.key, str(feature.shape), feature.dtype, feature.unit, feature.encoding)
        console.print(features)
        return 0
