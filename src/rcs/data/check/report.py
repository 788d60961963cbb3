"""What a check found: findings with a severity and a stable kind, and the report of them all."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

Severity = Literal["damage", "warning"]
"""`damage`: not as it was written, or not readable. `warning`: as it was written, and doubtful as training data."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that is wrong."""

    severity: Severity
    """How bad it is."""
    kind: str
    """What it is, in a word that stays the same between versions: `altered`, `frozen`, `joint_jump` and so on."""
    episode: str | None
    """The episode's id; None for the dataset as a whole."""
    file: str
    """The file, relative to the dataset's folder."""
    message: str
    """What is wrong, and what to do if anything can be done."""
    rows: tuple[int, int] | None = None
    """The first and the last row that are touched, if that is known."""

    @property
    def place(self) -> str:
        """The rows in words; empty if none are known."""
        if self.rows is None:
            return ""
        first, last = self.rows
        return f"row {first}" if first == last else f"rows {first} to {last}"

    def __str__(self) -> str:
        """Return the finding on one line."""
        return f"{self.severity}: {self.file}{', ' if self.rows else ''}{self.place}: {self.message}"

    def to_json(self) -> dict[str, Any]:
        """Return the fields as JSON values."""
        return {**asdict(self), "rows": None if self.rows is None else list(self.rows)}


@dataclass(frozen=True, kw_only=True)
class CheckReport:
    """What `check` looked at and found."""

    path: Path
    """The dataset's folder."""
    episodes: int
    """Complete episodes that were checked."""
    rows: int
    """Rows in them."""
    frames: int
    """Images that were decoded."""
    findings: tuple[Finding, ...]
    """All that is wrong: of the dataset first, then episode by episode."""
    notes: tuple[str, ...] = ()
    """What could not be checked, and why."""

    @property
    def damage(self) -> tuple[Finding, ...]:
        """What is not as it was written."""
        return tuple(finding for finding in self.findings if finding.severity == "damage")

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """What is as it was written, and doubtful."""
        return tuple(finding for finding in self.findings if finding.severity == "warning")

    @property
    def is_ok(self) -> bool:
        """Whether nothing is damaged; there may be warnings."""
        return not self.damage

    @property
    def summary(self) -> str:
        """One line: how much was checked and how much is wrong."""
        checked = (
            f"{counted(self.episodes, 'episode')}, {counted(self.rows, 'row')}, {counted(self.frames, 'image')} checked"
        )
        if self.is_ok:
            verdict = "all as it was written"
        else:
            touched = len({finding.episode for finding in self.damage if finding.episode is not None})
            verdict = f"damage in {counted(len(self.damage), 'place')} of {counted(touched, 'episode')}"
        warnings = f"; {counted(len(self.warnings), 'warning')}" if self.warnings else ""
        return f"{checked}: {verdict}{warnings}"

    def __str__(self) -> str:
        """Return one line per finding and per note, and the summary."""
        return "\n".join([*map(str, self.findings), *(f"note: {note}" for note in self.notes), self.summary])

    def to_json(self) -> dict[str, Any]:
        """Return the report as JSON values."""
        return {
            "path": str(self.path),
            "episodes": self.episodes,
            "rows": self.rows,
            "frames": self.frames,
            "damage": len(self.damage),
            "warnings": len(self.warnings),
            "findings": [finding.to_json() for finding in self.findings],
            "notes": list(self.notes),
        }


def counted(number: int, word: str) -> str:
    """Return a number of things in words, such as "1 row" and "2 rows"."""
    return f"{number} {word}" if number == 1 else f"{number} {word}s"


def listed(ids: Iterable[str], most: int = 5) -> str:
    """Return some ids in a line of text, and how many there are beyond them."""
    names = list(ids)
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
