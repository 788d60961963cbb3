"""`rcs-data recipe`: write what another project's trainer needs to learn from a dataset."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import tyro

from rcs_data import Dataset
from rcs_data.cli.console import plain_console
from rcs_data.convert.options import ExportOptions
from rcs_data.finetune.contents import contents
from rcs_data.finetune.lerobot import lerobot
from rcs_data.finetune.octo import octo
from rcs_data.finetune.openpi import Base, openpi
from rcs_data.finetune.openvla import openvla


@dataclass(kw_only=True)
class RecipeCommand:
    """Write what LeRobot, openpi, Octo or OpenVLA needs to learn from a dataset, and say how to go on."""

    family: tyro.conf.Positional[Literal["act", "diffusion", "smolvla", "openpi", "octo", "openvla"]]
    """What learns; the first three with LeRobot."""
    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    out: Path
    """Folder for the files; those of an earlier call are replaced."""
    base: Base = "pi05"
    """Of openpi: the published model to begin with."""
    name: str | None = None
    """Name of the export; that of the dataset's folder if left out."""
    state: tuple[str, ...] | None = None
    """Features that make up the state, as for `rcs-data export`."""
    action: tuple[str, ...] | None = None
    """Features that make up the action, as for `rcs-data export`."""
    cameras: tuple[str, ...] | None = field(default=None)
    """Cameras that the policy sees; all if left out."""

    def run(self) -> int:
        """Write the files and print the commands that follow."""
        options = ExportOptions(name=self.name, state=self.state, action=self.action, cameras=self.cameras)
        learned = contents(Dataset.open(self.path), options)
        match self.family:
            case "openpi":
                written = openpi(learned, self.base)
            case "octo":
                written = octo(learned)
            case "openvla":
                written = openvla(learned)
            case family:
                written = lerobot(learned, family)
        written.write(self.out)
        console = plain_console()
        for file in written.files:
            console.print(str(self.out / file))
        console.print("Then, with words in capitals filled in:")
        chosen = "".join(
            f" --{name} {' '.join(values)}"
            for name, values in (("state", self.state), ("action", self.action), ("cameras", self.cameras))
            if values
        )
        for step in written.steps:
            line = step.replace("FOLDER", str(self.out)).replace("DATASET", str(self.path))
            console.print(f"  {line}{chosen if line.startswith('rcs-data export') else ''}")
        return 0
