"""Two small datasets with cameras, times, flags, held matrices and simulation states."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature
from rcs_data.files.flags import FrameFlag

RGB, DEPTH = "observation/frames/wrist/rgb", "observation/frames/wrist/depth"
INTRINSICS = "observation/frames/wrist/intrinsics"
SIZE = (24, 16)
MakeDataset = Callable[..., Path]


def make_info(**changes: Any) -> DatasetInfo:
    features = (
        Feature(key="observation/joints", shape=(2,), dtype="float64", unit="rad"),
        Feature(key=RGB, shape=(SIZE[1], SIZE[0], 3), dtype="uint8", encoding="lossless"),
        Feature(key=DEPTH, shape=(SIZE[1], SIZE[0]), dtype="uint16", encoding="depth"),
        Feature(key=INTRINSICS, shape=(3, 3), dtype="float64", encoding="held"),
        Feature(key="action/joints", shape=(2,), dtype="float64", unit="rad"),
        Feature(key="action/gripper", shape=(1,), dtype="float32"),
        Feature(key="executed/joints", shape=(2,), dtype="float64", unit="rad"),
        Feature(key="reward", shape=(), dtype="float64"),
        Feature(key="terminated", shape=(), dtype="bool"),
        Feature(key="time/monotonic", shape=(), dtype="float64", unit="s"),
        Feature(key="time/period", shape=(), dtype="float64", unit="s"),
        Feature(key="time/frames/wrist", shape=(), dtype="float64", unit="s"),
        Feature(key="flags/frames/wrist", shape=(), dtype="uint8"),
    )
    values: dict[str, Any] = {
        "frequency": 30.0, "features": features, "setup": {"robot": "fr3", "relative": "last_step"},
        "instruction": "pick", "sim_state_size": 3,
    }  # fmt: skip
    return DatasetInfo(**{**values, **changes})


def record(path: Path, lengths: list[int], *, seed: int = 0, start: int = 0, **changes: Any) -> Path:
    """Record episodes of which everything is drawn from the seed; every third frame is a repeat."""
    rng = np.random.default_rng(seed)
    info = make_info(**changes)
    with DatasetWriter.open(path, info) as writer:
        for number, length in enumerate(lengths):
            with writer.episode(f"{start + number:06d}", seed=number) as episode:
                position = np.zeros(2)
                for i in range(length):
                    step = rng.normal(size=2)
                    is_repeat = i % 3 == 2
                    row: dict[str, Any] = {
                        "observation/joints": position,
                        RGB: None if is_repeat else rng.integers(0, 256, (SIZE[1], SIZE[0], 3), np.uint8),
                        DEPTH: None if is_repeat else rng.integers(0, 65536, (SIZE[1], SIZE[0]), np.uint16),
                        INTRINSICS: np.array([[20.0 + i // 5, 0, 12], [0, 20, 8], [0, 0, 1]]),
                        "terminated": i == length - 1,
                        "time/monotonic": 5 + i / 30,
                        "time/frames/wrist": 5 + (i - is_repeat) / 30,
                        "flags/frames/wrist": int(FrameFlag.REPEATED) if is_repeat else 0,
                    }
                    if i:
                        position = position + step
                        row["observation/joints"] = position
                        row |= {"action/joints": step, "action/gripper": rng.random(1, np.float32)}
                        row |= {"executed/joints": position, "reward": float(i), "time/period": 1 / 30}
                    episode.add(row, np.array([i, seed, number], np.float64))
                episode.finish(number % 2 == 0, {"failure": None if number % 2 == 0 else "slip"})
    return path


@pytest.fixture
def make_dataset() -> MakeDataset:
    return record


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    return record(tmp_path / "set", [13, 8, 1, 20])


@pytest.fixture
def ids(dataset: Path) -> list[str]:
    return [episode.id for episode in Dataset.open(dataset).episodes]
