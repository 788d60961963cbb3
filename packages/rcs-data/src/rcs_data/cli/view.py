"""`rcs-data info` and `view`: what a dataset has, in the terminal and as a page."""

from __future__ import annotations

import webbrowser
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.table import Table

from rcs_data import Dataset
from rcs_data.cli.console import plain_console, progress
from rcs_data.files.output import require_writable
from rcs_data.read.verdicts import Verdicts
from rcs_data.view import ClipOptions, Codec, write_view


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


@dataclass(kw_only=True)
class ViewCommand:
    """Write a page to look at a dataset with: videos, curves, flaws of the recording, two episodes side by side.

    It opens from the disk, without a server and without a network.
    """

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    out: Path | None = None
    """Folder of the page; by default `view` in that of the dataset."""
    episodes: tuple[str, ...] | None = None
    """Ids, or patterns such as "0001*", of the episodes to show; all by default."""
    height: int = 320
    """Largest height of the videos [px]."""
    codec: Codec = "h264"
    """How videos are stored; vp9 is for browsers that cannot play H.264."""
    open: bool = False
    """Open the page in the browser."""

    def run(self) -> int:
        """Write the page, and say where it is."""
        if self.out is not None:
            require_writable(self.out)
        console = plain_console()
        options = ClipOptions(height=self.height, codec=self.codec)
        with progress("Rendering") as tell:
            report = write_view(self.path, self.out, episodes=self.episodes, options=options, on_progress=tell)
        if self.open:
            webbrowser.open(report.path.resolve().as_uri())
        damaged = f", {report.damaged} damaged" if report.damaged else ""
        console.print(f"{report.rendered} episodes{damaged}; {report.size / 1e6:.1f} MB\nThe page: {report.path}")
        return 0
