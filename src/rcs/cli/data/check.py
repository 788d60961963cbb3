"""`rcs data check`: look for damage."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console

from rcs.data import check


@dataclass(kw_only=True)
class CheckCommand:
    """Check a dataset: hashes, counts, every frame. Exit code 1 when something is wrong."""

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    fast: bool = False
    """Do not decode the frames."""

    def run(self) -> int:
        """Check and print the findings."""
        report = check(self.path, decode_frames=not self.fast)
        Console(soft_wrap=True).print(str(report), highlight=False, markup=False)
        return 0 if report.is_ok else 1
