"""`rcs-data export`: write a dataset in a format for trainers."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import tyro

from rcs_data import Dataset
from rcs_data.cli.console import plain_console, progress
from rcs_data.convert.formats import export_format
from rcs_data.convert.options import ExportOptions


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
        cameras = () if self.more.cameras == ("none",) else self.more.cameras
        with progress(f"Exporting to {self.format}") as on_progress:
            options = replace(self.more, cameras=cameras, on_progress=on_progress)
            report = write(Dataset.open(self.path), self.out, options)
        console.print(
            f"{report.episodes} episodes, {report.steps} steps, {report.frames} images, "
            f"{report.bytes_written / 1e6:.1f} MB: {report.path}",
        )
        for note in report.notes:
            console.print(f"Note: {note}")
        return 0
