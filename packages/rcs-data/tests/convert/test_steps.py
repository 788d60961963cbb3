"""Formats without rows of their own for slow cameras and silent instructions give both back all the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature
from rcs_data.convert import (
    ExportOptions,
    export_lerobot,
    import_lerobot,
)
from rcs_data.files.flags import FrameFlag

RGB, DEPTH, FLAGS = "observation/frames/wrist/rgb", "observation/frames/wrist/depth", "flags/frames/wrist"


@pytest.fixture
def slow(tmp_path: Path) -> Dataset:
    """An episode without instruction, in a dataset with one, whose camera has a new frame in every second row."""
    features = (
        Feature(key="observation/joints", shape=(2,), dtype="float64"),
        Feature(key=RGB, shape=(64, 80, 3), dtype="uint8", encoding="jpeg"),
        Feature(key=DEPTH, shape=(6, 8), dtype="uint16", encoding="depth"),
        Feature(key="action/joints", shape=(2,), dtype="float64"),
        Feature(key=FLAGS, shape=(), dtype="uint8"),
    )
    info = DatasetInfo(frequency=30.0, features=features, setup={}, instruction="pick it up")
    with (
        DatasetWriter.open(tmp_path / "slow", info) as writer,
        writer.episode("a", seed=0, instruction="") as episode,
    ):
        for row in range(11):
            is_new = row % 2 == 0
            values: dict[str, Any] = {
                "observation/joints": np.full(2, row / 10),
                RGB: np.full((64, 80, 3), 20 * row, np.uint8) if is_new else None,
                DEPTH: np.full((6, 8), row, np.uint16) if is_new else None,
                FLAGS: 0 if is_new else int(FrameFlag.REPEATED),
            }
            episode.add(values | ({"action/joints": np.full(2, 0.1)} if row else {}))
        episode.finish(True)
    return Dataset.open(tmp_path / "slow")


def test_images_of_a_slow_camera_are_new_where_they_were(slow: Dataset, tmp_path: Path) -> None:
    export_lerobot(slow, tmp_path / "out", ExportOptions())
    back = import_lerobot(tmp_path / "out", tmp_path / "back")
    old, new = (dataset["a"].image_numbers([RGB])[RGB] for dataset in (slow, back))
    np.testing.assert_array_equal(np.diff(new[:-1]) > 0, np.diff(old[:-1]) > 0)
    new_images = [dataset["a"].timing["cameras"][RGB]["new_images"] for dataset in (slow, back)]
    assert new_images == [6, 5]  # the format has no observation after the last step


@pytest.mark.parametrize("version", ["3.0", "2.1"])
def test_an_episode_without_instruction_stays_without(slow: Dataset, tmp_path: Path, version: Any) -> None:
    export_lerobot(slow, tmp_path / "out", version=version)
    assert import_lerobot(tmp_path / "out", tmp_path / "back")["a"].instruction == ""
