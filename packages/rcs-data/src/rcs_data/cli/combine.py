"""`rcs-data merge`, `split` and `mix`: several datasets into one, one into several."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Table

from rcs_data import Dataset, edit
from rcs_data.cli.console import plain_console, progress
from rcs_data.errors import InvalidSetup
from rcs_data.read.verdicts import Verdicts


@dataclass(kw_only=True)
class MergeCommand:
    """Merge datasets with the same features."""

    sources: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of the datasets."""
    out: Path
    """Folder of the new dataset."""

    def run(self) -> int:
        """Merge and print the result."""
        with progress("Merging") as on_progress:
            merged = edit.merge(self.sources, self.out, on_progress=on_progress)
        return _tell([merged])


@dataclass(kw_only=True)
class SplitCommand:
    """Split a dataset by shares, such as `--parts train=0.9 val=0.1`, or a merged one into its sources."""

    path: tyro.conf.Positional[Path]
    """Folder of the dataset, which is not changed."""
    out: Path
    """Folder for the parts."""
    parts: Annotated[tuple[str, ...], tyro.conf.arg(metavar="[NAME=SHARE ...]")] = ()
    """The share of each part, as NAME=SHARE; they sum up to 1."""
    seed: int = 0
    """Seed of the draw."""

    def run(self) -> int:
        """Split and print the result."""
        shares = {name: _number(text, share) for text in self.parts for name, _, share in [text.partition("=")]}
        return _tell(list(edit.split(self.path, self.out, parts=shares or None, seed=self.seed).values()))


@dataclass(kw_only=True)
class MixCommand:
    """Mix episodes of several datasets, such as `rcs-data mix real:143 sim:500 --out mixed --seed 1`."""

    parts: tyro.conf.Positional[tuple[str, ...]]
    """Parts: DATASET for all episodes, DATASET:143 for 143 episodes, DATASET:0.7 for a share of the total."""
    out: Path
    """Folder of the new dataset."""
    seed: int = 0
    """Seed of the draw."""
    total: int | None = None
    """Total number of episodes, with shares."""
    common: bool = False
    """Leave out features that are not in all datasets."""
    drop: tuple[str, ...] = ()
    """Features to leave out: keys, or prefixes of keys."""
    rename: Annotated[tuple[str, ...], tyro.conf.arg(metavar="[DATASET/CAMERA=NAME ...]")] = ()
    """New names of cameras, as DATASET/CAMERA=NAME."""
    size: tuple[int, int] | None = None
    """Width and height of all frames [px]."""
    frequency: float | None = None
    """Control rate of all episodes [Hz]."""

    def run(self) -> int:
        """Mix and print the result."""
        names: dict[str, dict[str, str]] = {}
        for text in self.rename:
            place, equals, name = text.partition("=")
            dataset, slash, camera = place.partition("/")
            if not (equals and slash):
                raise InvalidSetup(f"Expected --rename DATASET/CAMERA=NAME; got {text!r}.")
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
        raise InvalidSetup(f"Expected --parts NAME=SHARE, such as train=0.9; got {text!r}.") from err


def _tell(made: list[Dataset]) -> int:
    table = Table("dataset", "episodes", "rows", "succeeded", "failed", "not judged", box=None, pad_edge=False)
    for dataset in made:
        rows = sum(episode.length for episode in dataset.episodes)
        how = Verdicts.of(episode.success for episode in dataset)
        table.add_row(*map(str, (dataset.path, len(dataset), rows, how.succeeded, how.failed, how.not_judged)))
    plain_console().print(table)
    return 0
