"""`rcs-data recover`: complete the episodes that a killed recording left open."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from rcs_data import recover
from rcs_data.cli.console import plain_console


@dataclass(kw_only=True)
class RecoverCommand:
    """Complete the episodes that a killed recording left open."""

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""

    def run(self) -> int:
        """Recover and print what was done."""
        report = recover(self.path)
        plain_console().print(str(report))
        return 0
