"""`rcs data delete`, `keep`, `trim`, `relabel`, `rename-camera`, `resample`, `resize`, `undo`, `history`, `prune`."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

import tyro
from rich.progress import Progress
from rich.table import Table

from rcs_data import Dataset, edit
from rcs_data.cli.console import plain_console
from rcs_data.errors import InvalidSetup
from rcs_data.output import OnProgress

Which = Literal["listed", "failed", "successful", "unjudged"]
_VERDICTS: dict[str, bool | None] = {"failed": False, "successful": True, "unjudged": None}


@dataclass(kw_only=True)
class _Selection:
    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    episodes: tuple[str, ...] = ()
    """Ids of episodes."""
    which: Which = "listed"
    """Instead of ids: all episodes that failed, succeeded, or have no verdict."""

    def ids(self) -> list[str]:
        """Return the ids of the chosen episodes.

        Raises:
            InvalidSetup: No episodes are chosen, or in two ways.
        """
        if (self.which == "listed") != bool(self.episodes):
            raise InvalidSetup("Choose episodes by --episodes ID ID …, or by --which failed, successful or unknown.")
        if self.episodes:
            return list(self.episodes)
        return [e.id for e in Dataset.open(self.path).episodes if e.success is _VERDICTS[self.which]]


@dataclass(kw_only=True)
class DeleteCommand(_Selection):
    """Delete episodes of a dataset; `undo` restores them."""

    def run(self) -> int:
        """Delete and print what is left."""
        edit.delete(self.path, self.ids())
        return _tell(self.path)


@dataclass(kw_only=True)
class KeepCommand(_Selection):
    """Delete all episodes but some; `undo` restores them."""

    def run(self) -> int:
        """Keep and print what is left."""
        edit.keep(self.path, self.ids())
        return _tell(self.path)


@dataclass(kw_only=True)
class TrimCommand:
    """Cut rows off the start and end of an episode."""

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    episode: str
    """Id of the episode."""
    first: int = 0
    """The row that becomes the first."""
    last: int = -1
    """The row that becomes the last; negative numbers count from the end."""

    def run(self) -> int:
        """Trim and print a summary."""
        edit.trim(self.path, self.episode, first=self.first, last=self.last)
        return _tell(self.path)


@dataclass(kw_only=True)
class RelabelCommand:
    """Change the instruction of some or all episodes."""

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    instruction: str
    """The new instruction."""
    episodes: tuple[str, ...] = ()
    """Ids of episodes; default: all."""

    def run(self) -> int:
        """Relabel and print a summary."""
        edit.relabel(self.path, self.instruction, episodes=self.episodes or None)
        return _tell(self.path)


@dataclass(kw_only=True)
class RenameCameraCommand:
    """Rename a camera."""

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    name: str
    """The camera."""
    to: str
    """Its new name."""

    def run(self) -> int:
        """Rename and print a summary."""
        with progress("Renaming") as on_progress:
            edit.rename_camera(self.path, self.name, self.to, on_progress=on_progress)
        return _tell(self.path)


@dataclass(kw_only=True)
class ResampleCommand:
    """Lower the control rate of all episodes, for example from 30 to 5 Hz."""

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    frequency: float
    """The new rate [Hz]."""

    def run(self) -> int:
        """Resample and print a summary."""
        with progress("Resampling") as on_progress:
            edit.resample(self.path, self.frequency, on_progress=on_progress)
        return _tell(self.path)


@dataclass(kw_only=True)
class ResizeCommand:
    """Scale the frames of all cameras and their intrinsics."""

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    size: tuple[int, int]
    """Width and height [px]."""

    def run(self) -> int:
        """Resize and print a summary."""
        with progress("Resizing") as on_progress:
            edit.resize(self.path, self.size, on_progress=on_progress)
        return _tell(self.path)


@dataclass(kw_only=True)
class UndoCommand:
    """Undo the last edit that is not undone yet."""

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""

    def run(self) -> int:
        """Undo and print what was undone."""
        line = edit.undo(self.path)
        plain_console().print(f"Undid {line.command} of {line.at}.")
        return _tell(self.path)


@dataclass(kw_only=True)
class HistoryCommand:
    """Show the edits of a dataset."""

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""

    def run(self) -> int:
        """Print a line per edit."""
        table = Table("when", "what", "with", "episodes after", box=None, pad_edge=False)
        for line in Dataset.open(self.path).history:
            given = ", ".join(f"{key}={_short(value)}" for key, value in line.arguments.items() if value is not None)
            table.add_row(line.at, line.command, given, str(line.episodes))
        plain_console().print(table)
        return 0


def _short(value: object) -> str:
    if not isinstance(value, list):
        return str(value)
    items = cast(list[object], value)
    return f"{items[0]} … {items[-1]} ({len(items)})" if len(items) > 2 else " ".join(map(str, items))


@dataclass(kw_only=True)
class PruneCommand:
    """Free the space of replaced episodes; former edits can then not be undone."""

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""

    def run(self) -> int:
        """Prune and print how much was freed."""
        freed = edit.prune(self.path)
        plain_console().print(f"{freed / 1e6:.1f} MB freed.")
        return 0


@contextmanager
def progress(doing: str) -> Generator[OnProgress]:
    """Show a bar while the block runs; yield the function that moves it."""
    with Progress(console=plain_console(stderr=True, soft_wrap=False)) as bar:
        task = bar.add_task(doing, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _tell(path: Path) -> int:
    dataset = Dataset.open(path)
    rows = sum(episode.length for episode in dataset.episodes)
    text = f"{len(dataset)} episodes, {rows} rows at {dataset.info.frequency:g} Hz. Undo: `rcs data undo {path}`."
    plain_console().print(text)
    return 0
