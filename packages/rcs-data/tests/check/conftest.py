"""A camera that sees an arm move as it can: nothing in it is wrong until a test makes it so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import DatasetInfo, DatasetWriter, Feature, JointBounds

RGB = "observation/frames/wrist/rgb"
FPS = 30.0
Rows = list[dict[str, Any]]
MakeMoving = Callable[..., Path]

ARM = JointBounds(
    arm="an arm of tests",
    names=tuple(f"joint{i}" for i in range(1, 8)),
    lower=(-2.8, -1.7, -2.8, -3.0, -2.8, 0.5, -2.8),
    upper=(2.8, 1.7, 2.8, -0.1, 2.8, 4.5, 2.8),
    velocity=(2.6, 2.6, 2.6, 2.6, 5.2, 4.2, 5.2),
)
INFO = DatasetInfo(
    frequency=FPS,
    features=(
        Feature(key="observation/joints", shape=(7,), dtype="float64", unit="rad", limits=ARM),
        Feature(key=RGB, shape=(8, 12, 3), dtype="uint8", encoding="jpeg"),
        Feature(key="action/joints", shape=(7,), dtype="float64", unit="rad"),
        Feature(key="terminated", shape=(), dtype="bool"),
        Feature(key="time/monotonic", shape=(), dtype="float64", unit="s"),
        Feature(key="time/frames/wrist", shape=(), dtype="float64", unit="s"),
        Feature(key="flags/frames/wrist", shape=(), dtype="uint8"),
    ),
    setup={"robot": "fr3", "stepping": "realtime", "cameras": ["wrist"]},
    instruction="pick the cuboid",
)


def moving_rows(length: int) -> Rows:
    """A slow swing of all joints around the home pose, a new image in every row."""
    rng = np.random.default_rng(length)
    home = np.array([0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785])
    rows: Rows = []
    for i in range(length):
        row: dict[str, Any] = {
            "observation/joints": home + 0.4 * np.sin(i / FPS),
            RGB: rng.integers(20, 236, (8, 12, 3), np.uint8),
            "terminated": i == length - 1,
            "time/monotonic": 50 + i / FPS,
            "time/frames/wrist": 50 + i / FPS - 0.01,
            "flags/frames/wrist": 0,
        }
        rows.append(row if i == 0 else {**row, "action/joints": row["observation/joints"]})
    return rows


def record_moving(
    path: Path,
    change: Callable[[Rows], object] = len,
    *,
    length: int = 120,
    episodes: int = 1,
    success: bool | None = True,
    outcome: dict[str, Any] | None = None,
    **changes: Any,
) -> Path:
    """Record episodes whose rows were changed before."""
    with DatasetWriter.open(path, replace(INFO, **changes)) as writer:
        for number in range(episodes):
            rows = moving_rows(length)
            change(rows)
            with writer.episode(f"{number:06d}", seed=number) as episode:
                for row in rows:
                    episode.add(row)
                episode.finish(success, outcome)
    return path


@pytest.fixture
def moving() -> MakeMoving:
    return record_moving


@pytest.fixture
def moving_info() -> DatasetInfo:
    return INFO


@pytest.fixture
def arm() -> JointBounds:
    return ARM
