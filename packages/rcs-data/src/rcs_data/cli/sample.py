"""`rcs-data sample`: what a policy would be fed, as pictures."""

from __future__ import annotations

import webbrowser
from dataclasses import dataclass
from pathlib import Path

import tyro

from rcs_data import Dataset, Windows
from rcs_data.cli.console import plain_console, progress
from rcs_data.output import require_writable
from rcs_data.statistics import Normalisation
from rcs_data.view import write_sample
from rcs_data.view.page import chosen_episodes


@dataclass(kw_only=True)
class SampleCommand:
    """Draw windows as a policy is fed with them, and write a page with their images, states, actions and statistics.

    Options are those of `rcs_data.Windows`, with which a training reads the dataset. Numbers are shown before and after
    normalisation; constant ones and far outliers are named.
    """

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    out: Path | None = None
    """The page; by default `sample.html` in the dataset's folder."""
    png: Path | None = None
    """Write the images as one picture too, a row per window."""
    windows: int = 8
    """Windows to draw."""
    seed: int = 0
    """Same seed, same windows."""
    state: tuple[str, ...] | None = None
    """Features that make up the state; by default joints, then gripper or hand."""
    action: tuple[str, ...] | None = None
    """Features that make up the action; by default the arm's part, then gripper or hand."""
    cameras: tuple[str, ...] | None = None
    """Cameras, such as "wrist", or "wrist/depth" for depth; by default the colour images of all, `none` for none."""
    episodes: tuple[str, ...] | None = None
    """Ids, or patterns such as "0001*", of the episodes to draw from; all by default."""
    history: int = 1
    """Observations in a window."""
    horizon: int = 16
    """Actions in a window."""
    image_size: tuple[int, int] | None = None
    """Width and height to scale colour images to [px]; as recorded by default."""
    normalise: Normalisation = "mean_std"
    """How numbers are normalised."""
    floor: float = 0.0
    """Least spread to divide by, in the unit of the numbers."""
    open: bool = False
    """Open the page in the browser."""

    def run(self) -> int:
        """Write the page, and say where it is and what is conspicuous."""
        for path in (self.out, self.png):
            if path is not None:
                require_writable(path, is_file=True)
        console = plain_console()
        dataset = Dataset.open(self.path)
        windows = Windows(
            dataset,
            history=self.history,
            horizon=self.horizon,
            state=self.state,
            action=self.action,
            cameras=() if self.cameras == ("none",) else self.cameras,
            episodes=chosen_episodes(dataset, self.episodes),
            image_size=self.image_size,
        )
        with progress("Reading") as on_progress:
            report = write_sample(
                windows,
                self.path / "sample.html" if self.out is None else self.out,
                title=f"{dataset.path.resolve().name}: what a policy is fed",
                count=self.windows,
                seed=self.seed,
                normalisation=self.normalise,
                floor=self.floor,
                png=self.png,
                on_progress=on_progress,
            )
        for words in report.warnings:
            console.print(f"warning: {words}")
        console.print(f"The page: {report.path}")
        if self.open:
            webbrowser.open(report.path.resolve().as_uri())
        return 0
