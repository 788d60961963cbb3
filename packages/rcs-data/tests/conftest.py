"""Datasets for the tests: a small arm with one camera, made without a simulation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import DatasetInfo, DatasetWriter, EpisodeRecord, Feature

Row = dict[str, Any]
MakeInfo = Callable[..., DatasetInfo]
MakeRows = Callable[..., list[Row]]
Record = Callable[..., EpisodeRecord]

STATE = 5


@pytest.fixture
def make_info() -> MakeInfo:
    return _info


@pytest.fixture
def make_rows() -> MakeRows:
    return _rows


@pytest.fixture
def record() -> Record:
    return _record


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """A dataset of three episodes with colour, depth and simulation state."""
    path = tmp_path / "dataset"
    with DatasetWriter.open(path, _info(images=True)) as writer:
        for seed in range(3):
            _record(writer, f"{seed:06d}", length=6 + seed, seed=seed)
    return path


def _info(*, images: bool = False, **changes: Any) -> DatasetInfo:
    features = [
        Feature(key="observation/joints", shape=(3,), dtype="float64", unit="rad"),
        Feature(key="observation/gripper", shape=(1,), dtype="float32"),
        Feature(key="action/joints", shape=(3,), dtype="float64", unit="rad"),
        Feature(key="action/index", shape=(2,), dtype="int32"),
        Feature(key="reward", shape=(), dtype="float64"),
        Feature(key="terminated", shape=(), dtype="bool"),
        Feature(key="time/monotonic", shape=(), dtype="float64", unit="s"),
        Feature(key="time/frames/wrist", shape=(), dtype="float64", unit="s"),
    ]
    if images:
        features.append(Feature(key="observation/frames/wrist/rgb", shape=(16, 24, 3), dtype="uint8", encoding="jpeg"))
        features.append(Feature(key="observation/frames/wrist/depth", shape=(8, 10), dtype="uint16", encoding="depth"))
    values = {"frequency": 30.0, "setup": {"robot": "fr3"}, "instruction": "pick the cuboid", "sim_state_size": STATE}
    return DatasetInfo(**{**values, "features": tuple(features), **changes})


def _rows(length: int, *, images: bool = False, seed: int = 0) -> list[Row]:
    rng = np.random.default_rng(seed)
    rows: list[Row] = []
    for i in range(length):
        row: Row = {
            "observation/joints": rng.normal(size=3),
            "observation/gripper": rng.random(1, np.float32),
            "terminated": i == length - 1,
            "time/monotonic": 100 + i / 30,
            "time/frames/wrist": 100 + i / 30 - 0.01,
        }
        if i:
            row |= {"action/joints": rng.normal(size=3), "action/index": np.array([i, -i], np.int32), "reward": i / 2}
        if images:
            row["observation/frames/wrist/rgb"] = np.full((16, 24, 3), (40 + 7 * i) % 256, np.uint8)
            row["observation/frames/wrist/depth"] = rng.integers(0, 65536, (8, 10), np.uint16)
        rows.append(row)
    return rows


def _record(writer: DatasetWriter, episode_id: str, *, length: int = 6, seed: int = 0) -> EpisodeRecord:
    images = any(feature.encoding == "jpeg" for feature in writer.info.features)
    with writer.episode(episode_id, seed=seed) as episode:
        for i, row in enumerate(_rows(length, images=images, seed=seed)):
            episode.add(row, np.full(STATE, float(i)) if writer.info.sim_state_size else None)
        return episode.finish(seed % 2 == 0, {"failure": None if seed % 2 == 0 else "slip"})
