"""Fixtures that tests of the page share: a dataset with pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import DatasetInfo, DatasetWriter, Feature
from rcs_data.files.flags import FrameFlag

LENGTHS = {"000000": 40, "000001": 25, "000002": 33}
SUCCESS = {"000000": True, "000001": False, "000002": None}


def grey(row: int) -> int:
    """Return the brightness of the colour images in a row, so that a picture says which row it is of."""
    return 30 + 5 * row


@pytest.fixture(scope="session")
def filmed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset of three episodes with two cameras, one with depth and flags, and with two late steps."""
    path = tmp_path_factory.mktemp("data") / "filmed"
    features = (
        Feature(key="observation/joints", shape=(3,), dtype="float64", unit="rad"),
        Feature(key="action/joints", shape=(3,), dtype="float64", unit="rad"),
        Feature(key="reward", shape=(), dtype="float64"),
        Feature(key="time/monotonic", shape=(), dtype="float64", unit="s"),
        Feature(key="flags/frames/side", shape=(), dtype="uint8"),
        Feature(key="observation/frames/side/rgb", shape=(60, 81, 3), dtype="uint8", encoding="jpeg"),
        Feature(key="observation/frames/side/depth", shape=(30, 40), dtype="uint16", unit="mm", encoding="depth"),
        Feature(key="observation/frames/wrist/rgb", shape=(32, 48, 3), dtype="uint8", encoding="lossless"),
    )
    info = DatasetInfo(
        frequency=30.0, features=features, setup={"task": "Pick", "robot": "fr3"}, instruction="pick it up"
    )
    with DatasetWriter.open(path, info) as writer:
        for episode_id, length in LENGTHS.items():
            with writer.episode(episode_id, seed=int(episode_id) + 7) as episode:
                time_now = 100.0
                for row in range(length):
                    time_now += 0.1 if row in (10, 20) else 1 / 30
                    values: dict[str, Any] = {
                        "observation/joints": np.sin(row / 5 + np.arange(3)),
                        "time/monotonic": time_now,
                        "flags/frames/side": np.uint8(FrameFlag.STALE if 5 <= row <= 7 else 0),
                        "observation/frames/side/rgb": np.full((60, 81, 3), grey(row), np.uint8),
                        "observation/frames/side/depth": np.full((30, 40), 500 + 10 * row, np.uint16),
                        "observation/frames/wrist/rgb": np.full((32, 48, 3), grey(row), np.uint8),
                    }
                    if row:
                        values |= {"action/joints": np.full(3, row / 10), "reward": row / 2}
                    episode.add(values)
                success = SUCCESS[episode_id]
                episode.finish(success, {"failure": "slip" if success is False else None})
    return path
