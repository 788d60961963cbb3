"""`rcs-data view`: a page to look at a dataset with."""

from __future__ import annotations

import webbrowser
from dataclasses import dataclass
from pathlib import Path

import tyro

from rcs_data import Dataset
from rcs_data.cli.console import plain_console, progress
from rcs_data.output import OnProgress, require_writable
from rcs_data.view import ClipOptions, Codec, write_view
from rcs_data.view.rerun import write_rerun


@dataclass(kw_only=True)
class ViewCommand:
    """Write a page to look at a dataset with: videos, curves, flaws of the recording, two episodes side by side.

    It opens from the disk, without a server and without a network. Called again, only what changed is rendered.
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
    rerun: Path | None = None
    """Write a recording for the Rerun viewer, such as picks.rrd, instead of a page."""

    def run(self) -> int:
        """Write the page, or the recording, and say where it is."""
        if self.rerun is not None:
            require_writable(self.rerun, is_file=True)
        elif self.out is not None:
            require_writable(self.out)
        console = plain_console()
        dataset = Dataset.open(self.path)
        with progress("Writing" if self.rerun else "Rendering") as tell:
            lines = self._record(dataset, self.rerun, tell) if self.rerun else self._render(dataset, tell)
        for line in lines:
            console.print(line)
        return 0

    def _record(self, dataset: Dataset, path: Path, tell: OnProgress) -> list[str]:
        count = write_rerun(dataset, path, episodes=self.episodes, on_progress=tell)
        return [f"{count} episodes, {path.stat().st_size / 1e6:.1f} MB", f"Look at them with: rerun {path}"]

    def _render(self, dataset: Dataset, tell: OnProgress) -> list[str]:
        options = ClipOptions(height=self.height, codec=self.codec)
        report = write_view(dataset, self.out, episodes=self.episodes, options=options, on_progress=tell)
        if self.open:
            webbrowser.open(report.path.resolve().as_uri())
        damaged = f", {report.damaged} damaged" if report.damaged else ""
        counts = f"{report.rendered} episodes rendered, {report.kept} kept{damaged}; {report.size / 1e6:.1f} MB"
        return [counts, f"The page: {report.path}"]
