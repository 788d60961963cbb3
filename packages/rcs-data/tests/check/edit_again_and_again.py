"""A program that edits a dataset, a number of times: run as `edit_again_and_again.py DATASET EDITS`."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Callable
from pathlib import Path

from rcs_data import Dataset, edit


def main(path: Path, edits: int) -> None:
    """Edit in turns, so that every episode is there at the end."""
    first, second, *_ = [episode.id for episode in Dataset.open(path)]
    turns: list[Callable[[int], object]] = [
        lambda _: edit.trim(path, first),  # the same rows in a new folder
        lambda _: edit.prune(path),
        lambda _: edit.delete(path, [second]),
        lambda _: edit.undo(path),
        lambda number: edit.relabel(path, f"pick cuboid {number}"),
        lambda _: edit.trim(path, second),
        lambda _: edit.undo(path),
    ]
    for number, turn in zip(range(edits), itertools.cycle(turns), strict=False):
        turn(number)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
