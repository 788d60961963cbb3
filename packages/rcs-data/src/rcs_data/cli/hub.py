"""`rcs-data pull` and `rcs-data push`: LeRobot datasets from and to the Hugging Face Hub."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from rcs_data.cli.console import plain_console
from rcs_data.hub import pull, push


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
        cameras = () if self.cameras == ("none",) else self.cameras
        pull(self.repo, self.out, revision=self.revision, episodes=self.episodes, cameras=cameras)
        more = "".join(
            f" --{name} {' '.join(values)}"
            for name, values in (("episodes", self.episodes), ("cameras", self.cameras))
            if values
        )
        console = plain_console()
        console.print(f"{self.repo}: {self.out}")
        console.print(f"Import it with: rcs-data import {self.out} --out DATASET{more}")
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
