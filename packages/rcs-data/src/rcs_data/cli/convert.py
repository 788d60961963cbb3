"""`rcs-data export`, `import`, `pull`, `push`, `recipe`: datasets in the formats of others, and for their trainers."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import tyro

from rcs_data import Dataset
from rcs_data.cli.console import plain_console, progress
from rcs_data.convert.formats import export_format, import_format
from rcs_data.convert.lerobot.hub import pull, push
from rcs_data.convert.options import ExportOptions, ImportOptions
from rcs_data.convert.recipe.recipe import Base, Family, recipe
from rcs_data.read.verdicts import Verdicts


@dataclass(kw_only=True)
class ExportCommand:
    """Write a dataset in a format for trainers."""

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    out: Path
    """File or folder to write; it must not exist yet."""
    format: str
    """lerobot-v3, lerobot-v2.1 (openpi), gr00t, rlds (Octo, OpenVLA), robomimic, or mcap (Foxglove, Rerun)."""
    more: tyro.conf.SuppressFixed[ExportOptions] = field(default_factory=ExportOptions)

    def run(self) -> int:
        """Export and print what was written."""
        console = plain_console()
        write = export_format(self.format)
        with progress(f"Exporting to {self.format}") as on_progress:
            options = replace(self.more, cameras=_cameras(self.more.cameras), on_progress=on_progress)
            report = write(Dataset.open(self.path), self.out, options)
        console.print(
            f"{report.episodes} episodes, {report.steps} steps, {report.frames} images, "
            f"{report.bytes_written / 1e6:.1f} MB: {report.path}",
        )
        for note in report.notes:
            console.print(f"Note: {note}")
        return 0


@dataclass(kw_only=True)
class ImportCommand:
    """Import a dataset of another format, so that it can be checked, edited and mixed."""

    source: tyro.conf.Positional[Path]
    """File or folder to read."""
    out: Path
    """Folder of the new dataset; it must not exist yet."""
    format: str = "auto"
    """lerobot, rlds, aloha or robomimic; default: detected."""
    more: tyro.conf.SuppressFixed[ImportOptions] = field(default_factory=ImportOptions)

    def run(self) -> int:
        """Import and print the result."""
        console = plain_console()
        read = import_format(self.format, self.source)
        with progress("Importing") as on_progress:
            options = replace(self.more, cameras=_cameras(self.more.cameras), on_progress=on_progress)
            options = replace(options, on_note=lambda note: console.print(f"Note: {note}"))
            dataset = read(self.source, self.out, options)
        rows = sum(episode.length for episode in dataset.episodes)
        console.print(f"{len(dataset)} episodes, {rows} rows: {dataset.path}")
        console.print(f"Success: {Verdicts.of(episode.success for episode in dataset)}")
        imported: dict[str, Any] = dataset.info.setup.get("imported", {})
        for name, reason in imported.get("left_out", {}).items():
            console.print(f"Note: {name} was left out: {reason}.")
        return 0


@dataclass(kw_only=True)
class PullCommand:
    """Download a LeRobot dataset from the Hugging Face Hub, whole or in part; import it afterwards."""

    repo: tyro.conf.Positional[str]
    """Its name, such as lerobot/pusht."""
    out: Path
    """Folder to make; an incomplete one is completed."""
    revision: str | None = None
    """Branch, tag or commit; default: the newest."""
    episodes: tuple[str, ...] | None = None
    """Numbers of episodes, and ranges such as 0-99 or 200-; default: all."""
    cameras: tuple[str, ...] | None = None
    """Cameras, or `none`; default: all."""

    def run(self) -> int:
        """Download and print how to go on."""
        pull(self.repo, self.out, revision=self.revision, episodes=self.episodes, cameras=_cameras(self.cameras))
        more = _options(episodes=self.episodes, cameras=self.cameras)
        plain_console().print(
            f"{self.repo}: {self.out}\nImport it with: rcs-data import {shlex.quote(str(self.out))} --out DATASET{more}"
        )
        return 0


@dataclass(kw_only=True)
class PushCommand:
    """Upload an export in LeRobot's format to the Hugging Face Hub."""

    path: tyro.conf.Positional[Path]
    """Folder of the export."""
    repo: tyro.conf.Positional[str]
    """Its name, such as me/pick; it is made if it does not exist."""
    private: bool = False
    """Whether a new repository can be seen only by its owners."""

    def run(self) -> int:
        """Upload and print the address."""
        plain_console().print(push(self.path, self.repo, private=self.private))
        return 0


@dataclass(kw_only=True)
class RecipeCommand:
    """Write what LeRobot, openpi, Octo or OpenVLA needs to learn from a dataset, and say how to go on."""

    family: tyro.conf.Positional[Family]
    """The family of policies; the first three are trained with LeRobot."""
    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    out: Path
    """Folder for the files; those of an earlier call are replaced."""
    base: Base = "pi05"
    """The published model that openpi begins with."""
    name: str | None = None
    """Name of the export; that of the dataset's folder if left out."""
    state: tuple[str, ...] | None = None
    """Features that make up the state, as for `rcs-data export`."""
    action: tuple[str, ...] | None = None
    """Features that make up the action, as for `rcs-data export`."""
    cameras: tuple[str, ...] | None = None
    """Cameras that the policy sees; all if left out."""

    def run(self) -> int:
        """Write the files and print the commands that follow."""
        options = ExportOptions(name=self.name, state=self.state, action=self.action, cameras=self.cameras)
        made = recipe(self.family, Dataset.open(self.path), options, self.base)
        made.write(self.out)
        console = plain_console()
        for file in made.files:
            console.print(str(self.out / file))
        console.print("Then, with words in capitals filled in:")
        chosen = _options(state=self.state, action=self.action, cameras=self.cameras)
        for step in made.steps:
            # Absolute, since some change the folder first.
            folder, dataset = (shlex.quote(str(path.absolute())) for path in (self.out, self.path))
            line = step.replace("FOLDER", folder).replace("DATASET", dataset)
            console.print(f"  {line}{chosen if line.startswith('rcs-data export') else ''}")
        return 0


def _cameras(given: tuple[str, ...] | None) -> tuple[str, ...] | None:
    """Return the cameras of a command line, on which `none` stands for no camera."""
    return () if given == ("none",) else given


def _options(**given: tuple[str, ...] | None) -> str:
    """Return options as they are typed; those that are not given are left out."""
    return "".join(f" --{name} {' '.join(values)}" for name, values in given.items() if values)
