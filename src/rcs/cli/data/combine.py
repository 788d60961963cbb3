"""`rcs data merge`, `split` and `mix`: one dataset of several, several of one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.table import Table

from rcs.cli.console import plain_console
from rcs.cli.data.edit import progress
from rcs.data import Dataset, edit
from rcs.data.verdicts import Verdicts
from rcs.errors import InvalidSetup


@dataclass(kw_only=True)
class MergeCommand:
    """Make one dataset of several with the same features."""

    sources: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of the datasets."""
    out: Path
    """Folder of the new dataset."""

    def run(self) -> int:
        """Merge and say what was made."""
        with progress("Merging") as on_progress:
            merged = edit.merge(self.sources, self.out, on_progress=on_progress)
        return _tell([merged])


@dataclass(kw_only=True)
class SplitCommand:
    """Make several datasets of one: by shares, such as `--parts train=0.9 val=0.1`; without, a merged one's sources."""

    path: tyro.conf.Positional[Path]
    """Folder of the dataset; it stays."""
    out: Path
    """Folder in which the parts are made."""
    parts: tuple[str, ...] = ()
    """The share of each part, as NAME=SHARE; together 1."""
    seed: int = 0
    """Of the draw."""

    def run(self) -> int:
        """Split and say what was made."""
        shares = {name: _number(text, share) for text in self.parts for name, _, share in [text.partition("=")]}
        return _tell(list(edit.split(self.path, self.out, parts=shares or None, seed=self.seed).values()))


@dataclass(kw_only=True)
class MixCommand:
    """Make a dataset of episodes of others, such as `rcs data mix real:143 sim:500 --out mixed --seed 1`."""

    parts: tyro.conf.Positional[tuple[str, ...]]
    """What to take: DATASET for all episodes, DATASET:143 for so many, DATASET:0.7 for a share of the total."""
    out: Path
    """Folder of the new dataset."""
    seed: int = 0
    """Of the draw."""
    total: int | None = None
    """Episodes in all, with shares."""
    common: bool = False
    """Leave out features that not all have."""
    drop: tuple[str, ...] = ()
    """Features to leave out, or the start of their keys."""
    rename: tuple[str, ...] = ()
    """Other names of cameras, as DATASET/CAMERA=NAME."""
    size: tuple[int, int] | None = None
    """Width and height of all frames [px]."""
    frequency: float | None = None
    """Rate of all episodes [Hz]."""

    def run(self) -> int:
        """Mix and say what was made."""
        names: dict[str, dict[str, str]] = {}
        for text in self.rename:
            place, equals, name = text.partition("=")
            dataset, slash, camera = place.partition("/")
            if not (equals and slash):
                raise InvalidSetup(f"--rename {text!r} is no rename of a camera; write DATASET/CAMERA=NAME.")
            names.setdefault(dataset, {})[camera] = name
        how = edit.Harmonise(common=self.common, drop=self.drop, rename=names, size=self.size, frequency=self.frequency)
        parts = [edit.parse_part(text) for text in self.parts]
        with progress("Mixing") as on_progress:
            mixed = edit.mix(parts, self.out, seed=self.seed, total=self.total, mapping=how, on_progress=on_progress)
        return _tell([mixed])


def _number(text: str, share: str) -> float:
    try:
        return float(share)
    except ValueError as err:
        raise InvalidSetup(f"--parts {text!r} is no share; write NAME=SHARE, such as train=0.9.") from err


def _tell(made: list[Dataset]) -> int:
    table = Table("dataset", "episodes", "rows", "succeeded", "failed", "not judged", box=None, pad_edge=False)
    for dataset in made:
        rows = sum(episode.length for episode in dataset.episodes)
        how = Verdicts.of(episode.success for episode in dataset)
        table.add_row(*map(str, (dataset.path, len(dataset), rows, how.succeeded, how.failed, how.not_judged)))
    plain_console().print(table)
    return 0
