"""`rcs data export`: write a dataset in a format that a trainer reads."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console
from rich.progress import Progress

from rcs.data import Dataset
from rcs.data.convert.formats import export_format
from rcs.data.convert.options import Codec, ExportOptions


@dataclass(kw_only=True)
class ExportCommand:
    """Write a dataset in a format that a trainer reads."""

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    out: Path
    """What to write; nothing may be there yet."""
    format: str
    """lerobot-v3, lerobot-v2.1 (openpi), gr00t, rlds (Octo, OpenVLA) or robomimic."""
    episodes: tuple[str, ...] | None = None
    """Ids of the episodes; default: all."""
    success_only: bool = False
    """Leave out episodes that are not known to have succeeded."""
    state: tuple[str, ...] | None = None
    """Features that make up the state; default: joints, then gripper or hand, robot by robot."""
    action: tuple[str, ...] | None = None
    """Features that make up the action; default: the arm's part, then gripper or hand."""
    extra: tuple[str, ...] = ()
    """More features of numbers, each as a column of its own."""
    cameras: tuple[str, ...] | None = None
    """Cameras; default: all. "none" leaves all images out."""
    robot_type: str | None = None
    """What the format calls the robot; default: its name in the setup."""
    fps: int | None = None
    """The rate to claim [Hz], where a format wants a whole number and the dataset has none."""
    codec: Codec = "h264"
    """How videos are compressed."""
    compress: bool = True
    """Compress images without loss where the format leaves the choice: smaller, and slower to read."""
    name: str | None = None
    """What the export is called inside, where the format has a place for that; default: the dataset's folder."""
    workers: int = 1
    """Threads that encode; each is one core."""

    def run(self) -> int:
        """Export and print what was written."""
        console = Console(soft_wrap=True)
        write = export_format(self.format)
        with Progress(console=console, transient=True) as progress:
            bar = progress.add_task(f"Exporting to {self.format}", total=None)
            options = ExportOptions(
                episodes=self.episodes,
                success_only=self.success_only,
                state=self.state,
                action=self.action,
                extra=self.extra,
                cameras=() if self.cameras == ("none",) else self.cameras,
                robot_type=self.robot_type,
                fps=self.fps,
                codec=self.codec,
                compress=self.compress,
                name=self.name,
                workers=self.workers,
                on_progress=lambda done, total: progress.update(bar, completed=done, total=total),
            )
            report = write(Dataset.open(self.path), self.out, options)
        console.print(
            f"{report.episodes} episodes, {report.steps} steps, {report.frames} images, "
            f"{report.bytes_written / 1e6:.1f} MB: {report.path}",
            highlight=False,
        )
        for note in report.notes:
            console.print(f"Note: {note}", highlight=False, markup=False)
        return 0
