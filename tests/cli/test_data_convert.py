"""`rcs data export` and `rcs data import`: what is told, what is left on disk, exit codes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature


@pytest.fixture
def source(tmp_path: Path) -> Path:
    features = (
        Feature(key="observation/joints", shape=(2,), dtype="float64"),
        Feature(key="action/joints", shape=(2,), dtype="float64"),
    )
    info = DatasetInfo(frequency=10, features=features, setup={"robot": "so101"}, instruction="wave")
    with DatasetWriter.open(tmp_path / "source", info) as writer:
        for name, verdict in (("a", True), ("b", False)):
            with writer.episode(name, seed=None) as episode:
                for row in range(4):
                    moved = {"action/joints": np.full(2, float(row))} if row else {}
                    episode.add({"observation/joints": np.full(2, float(row)), **moved})
                episode.finish(verdict)
    return tmp_path / "source"


def test_a_dataset_goes_out_and_comes_back(call: Any, source: Path, tmp_path: Path) -> None:
    out, back = tmp_path / "lerobot", tmp_path / "back"
    code, told = call("data", "export", source, "--format", "lerobot-v3", "--out", out)
    assert code == 0
    assert "2 episodes, 6 steps" in told
    code, told = call("data", "import", out, "--out", back)
    assert code == 0
    assert "2 episodes, 8 rows" in told
    assert [episode.success for episode in Dataset.open(back).episodes] == [True, False]


def test_a_collected_dataset_has_no_warnings_after_a_round_trip(call: Any, tmp_path: Path) -> None:
    collected, out, back = (tmp_path / name for name in ("collected", "lerobot", "back"))
    words = ["--episodes", 2, "--cameras", "none", "--workers", 1, "--out", collected]
    assert call("collect", "PickCuboid", *words)[0] == 0
    assert "simulated_time" not in call("data", "export", collected, "--format", "lerobot-v3", "--out", out)[1]
    assert call("data", "import", out, "--out", back)[0] == 0
    code, told = call("data", "check", back, "--strict")
    assert (code, "no damage\n" in told) == (0, True), told


def test_choices_arrive_in_the_export(call: Any, source: Path, tmp_path: Path) -> None:
    out = tmp_path / "gr00t"
    options = ["--success-only", "--robot-type", "arm", "--cameras", "none"]
    assert call("data", "export", source, "--format", "gr00t", "--out", out, *options)[0] == 0
    info = json.loads((out / "meta" / "info.json").read_text())
    assert (info["total_episodes"], info["robot_type"], info["codebase_version"]) == (1, "arm", "v2.1")
    assert (out / "meta" / "modality.json").exists()


def test_an_unknown_format_is_told_with_the_known_ones(call: Any, source: Path, tmp_path: Path) -> None:
    code, told = call("data", "export", source, "--format", "lerobot", "--out", tmp_path / "out")
    assert code != 0
    assert "lerobot-v3" in told


def test_a_file_for_robomimic_is_recognised_when_it_comes_back(call: Any, source: Path, tmp_path: Path) -> None:
    out, back = tmp_path / "out.hdf5", tmp_path / "back"
    code, told = call("data", "export", source, "--format", "robomimic", "--out", out, "--no-compress")
    assert code == 0
    assert "Actions range from 1 to 3 as recorded" in told
    assert call("data", "import", out, "--out", back, "--lossless")[0] == 0
    counts = [[(episode.id, episode.length) for episode in Dataset.open(path).episodes] for path in (source, back)]
    assert counts[0] == counts[1]


def test_an_rlds_dataset_has_the_name_that_it_was_given(call: Any, source: Path, tmp_path: Path) -> None:
    code, told = call("data", "export", source, "--format", "rlds", "--out", tmp_path / "out", "--name", "Wave")
    assert code == 0
    assert "float32" in told
    assert json.loads((tmp_path / "out/Wave/1.0.0/dataset_info.json").read_text())["name"] == "Wave"
