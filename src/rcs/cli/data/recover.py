"""`rcs data recover`: bring back what a killed recording left open."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console

from rcs.data import recover


@dataclass(kw_only=True)
class RecoverCommand:
    """Bring back the episodes that were open when a recording was killed."""

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""

    def run(self) -> int:
        """Recover and print what was done."""
        report = recover(self.path)
        Console(soft_wrap=True).print(str(report), highlight=False, markup=False)
        return 0
