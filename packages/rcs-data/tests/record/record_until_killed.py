"""A program that records without end and says what it has done: `record_until_killed.py FOLDER [COPIES]`.

Without copies, it finishes one episode and adds rows to the next one, with the time when each was added. With copies,
it records as many open episodes in turns: in every round each copy adds a row, and its episodes have 20 rows and one
more for every copy before it. Every second copy is recorded in the background.
"""

from __future__ import annotations

import itertools
import os
import sys
import time

import numpy as np
from rcs_data import DatasetInfo, DatasetWriter, EpisodeWriter, Feature
from rcs_data.record.background import BackgroundEpisode

COPIES = int(sys.argv[2]) if len(sys.argv) > 2 else 0
INFO = DatasetInfo(
    frequency=20 if COPIES else 500,
    features=(
        Feature(key="observation/number", shape=(), dtype="int64"),
        Feature(key="observation/frames/wrist/rgb", shape=(32, 32, 3), dtype="uint8", encoding="jpeg"),
    ),
    setup={},
    instruction="",
)


def record_one(writer: DatasetWriter) -> None:
    """Record an episode, and then one without end."""
    image = np.random.default_rng(0).integers(0, 255, (32, 32, 3), np.uint8)
    with writer.episode("done", seed=0) as episode:
        episode.add({"observation/number": 0, "observation/frames/wrist/rgb": image})
        episode.finish(True, {})
    with writer.episode("open", seed=1) as episode:
        for number in itertools.count():
            episode.add({"observation/number": number, "observation/frames/wrist/rgb": image})
            os.write(1, f"{number} {time.monotonic()}\n".encode())
            time.sleep(0.002)


def record_many(writer: DatasetWriter) -> None:
    """Record episodes of copies in turns."""
    episodes: dict[int, EpisodeWriter | BackgroundEpisode] = {}
    for turn, copy in itertools.product(range(10_000), range(COPIES)):
        length = 20 + copy
        if turn % length == 0:
            episode = writer.episode(f"{copy:02d}-{turn // length:04d}", seed=copy)
            episodes[copy] = BackgroundEpisode(episode) if copy % 2 else episode
        image = np.full((32, 32, 3), 10 * copy, np.uint8)
        number = 10_000 * copy + turn % length
        episodes[copy].add({"observation/number": number, "observation/frames/wrist/rgb": image})
        os.write(1, f"{episodes[copy].id} added\n".encode())
        if turn % length == length - 1:
            episodes[copy].finish(True)
            os.write(1, f"{episodes[copy].id} finished\n".encode())


if __name__ == "__main__":
    with DatasetWriter.open(sys.argv[1], INFO) as dataset:
        (record_many if COPIES else record_one)(dataset)
