"""`rcs-data check` and `recover`: find what is wrong with a dataset, and repair what can be repaired."""

from __future__ import annotations

import json as json_
from dataclasses import asdict, dataclass
from pathlib import Path

import tyro

from rcs_data import CheckReport, check, recover
from rcs_data.check.dataset import Depth
from rcs_data.check.repair import Mending, repair
from rcs_data.cli.console import plain_console, progress
from rcs_data.files.layout import has_dataset

_STYLES = {"damage": "bold red", "warning": "yellow"}


@dataclass(kw_only=True)
class CheckCommand:
    """Check a dataset: bytes, images, times, motion, labels. Exit code 1 if something is damaged.

    Damage means that bytes are not as written. Warnings are about doubtful training data: gaps, frozen or black images,
    jumps, joints beyond their limits, missing verdicts.
    """

    path: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    depth: Depth = "frames"
    """How deep to check: `bytes` compares all hashes, `rows` also reads the numbers, and `frames` also decodes the
    images."""
    strict: bool = False
    """Exit with code 1 for warnings, too."""
    repair: bool = False
    """Repair first: restore the index, complete what a kill left, put damaged episodes into the folder `quarantine`."""
    json: bool = False
    """Print JSON instead of lines."""

    def run(self) -> int:
        """Repair with `--repair`, check, and print the findings."""
        mended: list[Mending] | None = None
        if self.repair:
            with progress("Looking for damage") as on_progress:
                mended = repair(self.path, depth=self.depth, on_progress=on_progress)
        if mended and not has_dataset(self.path):  # but what was to become one
            report = CheckReport(path=self.path, episodes=0, rows=0, frames=0, findings=())
        else:
            with progress("Checking") as on_progress:
                report = check(self.path, depth=self.depth, on_progress=on_progress)
        if self.json:
            repaired = None if mended is None else [asdict(mending) for mending in mended]
            print(json_.dumps({**report.to_json(), "repair": repaired}, indent=1, ensure_ascii=False))
        else:
            _show(report, mended)
        return 1 if report.damage or (self.strict and report.warnings) else 0


def _show(report: CheckReport, mended: list[Mending] | None) -> None:
    console = plain_console()
    if mended is not None:
        console.print("\n".join(map(str, mended)) or "nothing to repair")
    for finding in report.findings:
        console.print(str(finding), style=_STYLES[finding.severity])
    for note in report.notes:
        console.print(f"note: {note}")
    console.print(report.summary)


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
