"""Compare the cost of a row with many open episodes, one per copy, with that of a single episode.

A row has the numbers of an arm, the simulation's state and a frame of 64 x 64 px. The copies take turns, as those of a
batch do. The reference, in the same run, is one open episode with as many rows.

Prints one JSON object: by number of open episodes, microseconds per row as the loop feels them, without (`here`) and
with (`background`) threads that encode and write, and milliseconds per `finish`.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np
import tyro
from rcs_data import DatasetInfo, DatasetWriter, Feature
from rcs_data.record.background import BackgroundEpisode

STATE = 64
FEATURES = (
    Feature(key="observation/joints", shape=(7,), dtype="float64"),
    Feature(key="observation/frames/side/rgb", shape=(64, 64, 3), dtype="uint8", encoding="jpeg"),
    Feature(key="action/joints", shape=(7,), dtype="float64"),
    Feature(key="reward", shape=(), dtype="float64"),
)


@dataclass(kw_only=True)
class Options:
    """Options of the benchmark."""

    copies: int = 24
    """Open episodes."""
    rows: int = 300
    """Rows of each."""
    rounds: int = 5
    """Repetitions; the median counts."""


def main(options: Options) -> None:
    """Measure and print."""
    told: dict[str, dict[str, float]] = {}
    for kind in ("here", "background"):
        rounds: dict[int, list[tuple[float, float]]] = {1: [], options.copies: []}
        for _ in range(options.rounds):
            for copies, found in rounds.items():
                found.append(
                    record(copies, options.copies * options.rows // copies, in_background=kind == "background")
                )
        for copies, found in rounds.items():
            told[f"{kind}, {copies} open"] = {
                "us_per_row": round(1e6 * median(row for row, _ in found), 1),
                "ms_per_finish": round(1e3 * median(finish for _, finish in found), 1),
            }
        print(kind, "measured", file=sys.stderr)
    print(json.dumps({"benchmark": "many_episodes", **told}))


def record(copies: int, rows: int, *, in_background: bool) -> tuple[float, float]:
    """Return the seconds that the loop spent per row and per `finish`."""
    info = DatasetInfo(frequency=30.0, features=FEATURES, setup={}, instruction="", sim_state_size=STATE)
    rng = np.random.default_rng(0)
    smooth = np.clip(np.cumsum(rng.normal(size=(20, 64, 64, 3)), axis=1) + 128, 0, 255).astype(np.uint8)
    numbers, state = rng.normal(size=(20, 7)), rng.normal(size=(20, STATE))
    with tempfile.TemporaryDirectory() as folder, DatasetWriter.open(Path(folder) / "dataset", info) as writer:
        opened = [writer.episode(f"{copy:03d}", seed=copy) for copy in range(copies)]
        episodes = [BackgroundEpisode(episode) if in_background else episode for episode in opened]
        start = time.perf_counter()
        for i in range(rows):
            row = {FEATURES[0].key: numbers[i % 20], FEATURES[1].key: smooth[i % 20]}
            if i:
                row |= {FEATURES[2].key: numbers[i % 20], FEATURES[3].key: np.float64(i)}
            for episode in episodes:
                episode.add(row, state[i % 20])
        added = time.perf_counter()
        for episode in episodes:
            episode.finish(None)
        end = time.perf_counter()
    return (added - start) / rows / copies, (end - added) / copies


if __name__ == "__main__":
    main(tyro.cli(Options))
