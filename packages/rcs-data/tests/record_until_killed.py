"""A program that records one finished episode and then rows without end; it says when each row was added."""

from __future__ import annotations

import itertools
import os
import sys
import time

import numpy as np
from rcs_data import DatasetInfo, DatasetWriter, Feature

INFO = DatasetInfo(
    frequency=500,
    features=(
        Feature(key="observation/number", shape=(), dtype="int64"),
        Feature(key="observation/frames/wrist/rgb", shape=(32, 32, 3), dtype="uint8", encoding="jpeg"),
    ),
    setup={},
    instruction="",
)


def main(path: str) -> None:
    """Record until killed."""
    image = np.random.default_rng(0).integers(0, 255, (32, 32, 3), np.uint8)
    with DatasetWriter.open(path, INFO) as writer:
        with writer.episode("done", seed=0) as episode:
            episode.add({"observation/number": 0, "observation/frames/wrist/rgb": image})
            episode.finish(True, {})
        with writer.episode("open", seed=1) as episode:
            for number in itertools.count():
                episode.add({"observation/number": number, "observation/frames/wrist/rgb": image})
                os.write(1, f"{number} {time.monotonic()}\n".encode())
                time.sleep(0.002)


if __name__ == "__main__":
    main(sys.argv[1])
