"""`rcs-data delete`, `keep`, `trim`, `relabel`, `rename-camera`, `resample`, `resize`, `undo`, `history`, `prune`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import tyro
from rich.table import Table

from rcs_data import Dataset, edit
from rcs_data.cli.console import plain_console, progress
from rcs_data.errors import InvalidSetup

Which = Literal["listed", "failed", "successful", "unjudged"]
_VERDICTS: dict[str, bool | None] = {"failed": False, "successful": True, "unjudged": None}


@dataclass(kw_only=True)
class _Edit:
    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""

    def show(self, hint: str = "") -> int:
        """Print what the dataset has now, and a hint."""
        dataset = Dataset.open(self.path)
        rows = sum(episode.length for episode in dataset.episodes)
        plain_console().print(f"{len(dataset)} episodes, {rows} rows at {dataset.info.frequency:g} Hz.{hint}")
        return 0

    def done(self) -> int:
        """Print what the dataset has now, and how to undo the edit."""
        return self.show(f" Undo: `rcs-data undo {self.path}`.")


@dataclass(kw_only=True)
class _Selection(_Edit):
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
            raise InvalidSetup("Choose episodes by --episodes ID ID …, or by --which failed, successful or unjudged.")
        if self.episodes:
            return list(self.episodes)
        return [e.id for e in Dataset.open(self.path).episodes if e.success is _VERDICTS[self.which]]


@dataclass(kw_only=True)
class DeleteCommand(_Selection):
    """Delete episodes of a dataset; `undo` restores them."""

    def run(self) -> int:
        """Delete, and print what is left."""
        edit.delete(self.path, self.ids())
        return self.done()


@dataclass(kw_only=True)
class KeepCommand(_Selection):
    """Delete all episodes but some; `undo` restores them."""

    def run(self) -> int:
        """Delete the others, and print what is left."""
        edit.keep(self.path, self.ids())
        return self.done()


@dataclass(kw_only=True)
class TrimCommand(_Edit):
    """Cut rows off the start and end of an episode."""

    episode: str
    """Id of the episode."""
    first: int = 0
    """The row that becomes the first."""
    last: int = -1
    """The row that becomes the last; negative numbers count from the end."""

    def run(self) -> int:
        """Trim, and print what is left."""
        edit.trim(self.path, self.episode, first=self.first, last=self.last)
        return self.done()


@dataclass(kw_only=True)
class RelabelCommand(_Edit):
    """Change the instruction of some or all episodes."""

    instruction: str
    """The new instruction."""
    episodes: tuple[str, ...] = ()
    """Ids of episodes; default: all."""

    def run(self) -> int:
        """Relabel, and print what the dataset has."""
        edit.relabel(self.path, self.instruction, episodes=self.episodes or None)
        return self.done()


@dataclass(kw_only=True)
class RenameCameraCommand(_Edit):
    """Rename a camera."""

    name: str
    """The camera."""
    to: str
    """Its new name."""

    def run(self) -> int:
        """Rename, and print what the dataset has."""
        with progress("Renaming") as on_progress:
            edit.rename_camera(self.path, self.name, self.to, on_progress=on_progress)
        return self.done()


@dataclass(kw_only=True)
class ResampleCommand(_Edit):
    """Lower the control rate of all episodes, for example from 30 to 5 Hz."""

    frequency: float
    """The new rate [Hz]."""

    def run(self) -> int:
        """Resample, and print what is left."""
        with progress("Resampling") as on_progress:
            edit.resample(self.path, self.frequency, on_progress=on_progress)
        return self.done()


@dataclass(kw_only=True)
class ResizeCommand(_Edit):
    """Scale the frames of all cameras and their intrinsics."""

    size: tuple[int, int]
    """Width and height [px]."""

    def run(self) -> int:
        """Resize, and print what the dataset has."""
        with progress("Resizing") as on_progress:
            edit.resize(self.path, self.size, on_progress=on_progress)
        return self.done()


@dataclass(kw_only=True)
class UndoCommand(_Edit):
    """Undo the last edit that is not undone yet."""

    def run(self) -> int:
        """Undo it, and print what it was and what the dataset has now."""
        undone = edit.undo(self.path)
        plain_console().print(f"Undid {undone.command} with {_words(undone.arguments)}, of {undone.at}.")
        return self.show()


@dataclass(kw_only=True)
class HistoryCommand(_Edit):
    """Show the edits of a dataset."""

    def run(self) -> int:
        """Print a line per edit."""
        table = Table("when", "what", "with", "episodes after", box=None, pad_edge=False)
        for line in Dataset.open(self.path).history:
            table.add_row(line.at, line.command, _words(line.arguments), str(line.episodes))
        plain_console().print(table)
        return 0


@dataclass(kw_only=True)
class PruneCommand(_Edit):
    """Free the space of replaced episodes; former edits can then not be undone."""

    def run(self) -> int:
        """Prune and print how much was freed."""
        plain_console().print(f"{edit.prune(self.path) / 1e6:.1f} MB freed.")
        return 0


def _words(arguments: dict[str, Any]) -> str:
    return ", ".join(f"{key}={_short(value)}" for key, value in arguments.items() if value is not None)


def _short(value: object) -> str:
    items = cast(list[object], value) if isinstance(value, list) else [value]
    return f"{items[0]} … {items[-1]} ({len(items)})" if len(items) > 2 else " ".join(map(str, items))
