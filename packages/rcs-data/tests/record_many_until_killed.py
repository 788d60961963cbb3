"""A program that records 24 copies into as many open episodes, in turns and without end; it says what it has done.

In every round each copy adds a row. The episodes of copy c have 20 + c rows; then the next one begins. Every second
copy is recorded in the background.
"""

from __future__ import annotations

import itertools
import os
import sys

import numpy as np
from rcs_data import DatasetInfo, DatasetWriter, EpisodeWriter, Feature
from rcs_data.background import BackgroundEpisode

INFO = DatasetInfo(
    frequency=20,
    features=(
        Feature(key="observation/number", shape=(), dtype="int64"),
        Feature(key="observation/frames/wrist/rgb", shape=(32, 32, 3), dtype="uint8", encoding="jpeg"),
    ),
    setup={},
    instruction="",
)


def main(path: str) -> None:
    """Record until killed."""
    with DatasetWriter.open(path, INFO) as writer:
        episodes: dict[int, EpisodeWriter | BackgroundEpisode] = {}
        for turn, copy in itertools.product(range(10_000), range(24)):
            length = 20 + copy
            if turn % length == 0:
                episode = writer.episode(f"{copy:02d}-{turn // length:04d}", seed=copy)
                episodes[copy] = BackgroundEpisode(episode, INFO) if copy % 2 else episode
            image = np.full((32, 32, 3), 10 * copy, np.uint8)
            number = 10_000 * copy + turn % length
            episodes[copy].add({"observation/number": number, "observation/frames/wrist/rgb": image})
            os.write(1, f"{episodes[copy].id} added\n".encode())
            if turn % length == length - 1:
                episodes[copy].finish(True)
                os.write(1, f"{episodes[copy].id} finished\n".encode())


if __name__ == "__main__":
    main(sys.argv[1])
