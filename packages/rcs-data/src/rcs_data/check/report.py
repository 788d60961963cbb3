"""Findings of a check, each with a severity and a stable kind, and the report."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

Severity = Literal["damage", "warning"]
"""`damage`: not as written, or not readable. `warning`: intact, but doubtful as training data."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong."""

    severity: Severity
    kind: str
    """Its kind, a word that is stable across versions: `altered`, `frozen`, `joint_jump` and so on."""
    episode: str | None
    """The episode's id; None for the dataset as a whole."""
    file: str
    """The file, relative to the dataset's folder."""
    message: str
    """Words on what is wrong, and on what to do about it."""
    rows: tuple[int, int] | None = None
    """The first and last row concerned, if known."""

    def __str__(self) -> str:
        first, last = self.rows or (None, None)
        rows = "" if first is None else f", row {first}" if first == last else f", rows {first} to {last}"
        return f"{self.severity}: {self.file}{rows}: {self.message}"


@dataclass(frozen=True, kw_only=True)
class CheckReport:
    """The result of `check`."""

    path: Path
    """The dataset's folder."""
    episodes: int
    """Number of complete episodes checked."""
    rows: int
    frames: int
    """Number of decoded images."""
    findings: tuple[Finding, ...]
    """The findings: of the dataset first, then by episode."""
    notes: tuple[str, ...] = ()
    """Words on what could not be checked, and why."""

    @property
    def damage(self) -> tuple[Finding, ...]:
        """Findings of damage."""
        return tuple(finding for finding in self.findings if finding.severity == "damage")

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Findings of doubtful data."""
        return tuple(finding for finding in self.findings if finding.severity == "warning")

    @property
    def is_ok(self) -> bool:
        """Whether nothing is damaged; there may be warnings."""
        return not self.damage

    @property
    def summary(self) -> str:
        """One line with what was checked and what is wrong."""
        checked = (
            f"{counted(self.episodes, 'episode')}, {counted(self.rows, 'row')}, {counted(self.frames, 'image')} checked"
        )
        if self.is_ok:
            verdict = "no damage"
        else:
            touched = len({finding.episode for finding in self.damage if finding.episode is not None})
            verdict = f"damage in {counted(len(self.damage), 'place')} of {counted(touched, 'episode')}"
        warnings = f"; {counted(len(self.warnings), 'warning')}" if self.warnings else ""
        return f"{checked}: {verdict}{warnings}"

    def __str__(self) -> str:
        return "\n".join([*map(str, self.findings), *(f"note: {note}" for note in self.notes), self.summary])

    def to_json(self) -> dict[str, Any]:
        """Return the report as values that `json.dumps` takes, with the numbers of findings."""
        counts = {"damage": len(self.damage), "warnings": len(self.warnings)}
        return {**asdict(self), "path": str(self.path), **counts}


def counted(number: int, word: str) -> str:
    """Return a count with its noun, such as "1 row" and "2 rows"."""
    return f"{number} {word}" if number == 1 else f"{number} {word}s"


def listed(ids: Iterable[str], most: int = 5) -> str:
    """Return the first few ids in one line, and how many more there are."""
    names = list(ids)
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
