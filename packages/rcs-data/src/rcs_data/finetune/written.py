"""A configuration as files, and what to do with them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from rcs_data.finetune.contents import Contents


@dataclass(frozen=True, kw_only=True)
class Written:
    """What a family's trainer needs."""

    files: Mapping[str, str]
    """Text by file name."""
    export_format: str
    """Format of `rcs-data export` that the trainer reads."""
    steps: tuple[str, ...]
    """Commands, in order; FOLDER is where the files are, and words in capitals are yours to fill in."""

    def write(self, folder: Path) -> None:
        """Write the files; those of an earlier call are replaced."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in self.files.items():
            (folder / name).write_text(text, encoding="utf-8")


def facts(contents: Contents) -> str:
    """Return what the dataset is, as lines of a comment."""
    said = [f"Instruction: {contents.instruction}".rstrip(), f"Rate: {contents.rate:g} Hz"]
    said += [f"Camera {name}: {height} x {width}" for name, (height, width) in contents.cameras.items()]
    for what, parts in (("State", contents.state), ("Action", contents.action)):
        said += [f"{what} {part.name}: {part.size} numbers, {part.unit or 'no unit'}, {part.meaning}" for part in parts]
    return "\n".join(f"# {' '.join(line.split())}" for line in said)
