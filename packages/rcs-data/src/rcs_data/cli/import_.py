"""`rcs-data import`: import a dataset of another format."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import tyro

from rcs_data.cli.console import plain_console, progress
from rcs_data.convert.formats import import_format
from rcs_data.convert.options import ImportOptions
from rcs_data.verdicts import Verdicts


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
        cameras = () if self.more.cameras == ("none",) else self.more.cameras
        with progress("Importing") as on_progress:
            options = replace(self.more, cameras=cameras, on_progress=on_progress)
            options = replace(options, on_note=lambda note: console.print(f"Note: {note}"))
            dataset = read(self.source, self.out, options)
        rows = sum(episode.length for episode in dataset.episodes)
        console.print(f"{len(dataset)} episodes, {rows} rows: {dataset.path}")
        console.print(f"Success: {Verdicts.of(episode.success for episode in dataset)}")
        imported: dict[str, Any] = dataset.info.setup.get("imported", {})
        for name, reason in imported.get("left_out", {}).items():
            console.print(f"Note: {name} was left out: {reason}.")
        return 0
