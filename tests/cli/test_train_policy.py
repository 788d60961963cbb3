"""`rcs train --policy`, with a program in the place of LeRobot's trainer."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import DatasetInfo, DatasetWriter, Feature

from rcs.cli.train import TrainCommand
from rcs.errors import InvalidSetup
from rcs.rl.training import Course

PYTHON = """#!/bin/sh
echo "$@" >> {told}
test -e {works}
"""


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    features = [
        Feature(key=key, shape=(size,), dtype="float64", unit="rad")
        for key, size in (("observation/joints", 7), ("action/joints", 7))
    ]
    features.append(Feature(key="observation/frames/side/rgb", shape=(32, 48, 3), dtype="uint8", encoding="jpeg"))
    info = DatasetInfo(frequency=10.0, features=tuple(features), setup={"relative": "last_step"}, instruction="nod")
    with DatasetWriter.open(tmp_path / "nods", info) as writer, writer.episode("000000", seed=0) as episode:
        for row in range(4):
            values: dict[str, Any] = {"observation/joints": np.full(7, 0.1 * row)}
            values |= {"action/joints": np.zeros(7)} if row else {}
            episode.add(values | {"observation/frames/side/rgb": np.zeros((32, 48, 3), np.uint8)})
        episode.finish(True)
    return tmp_path / "nods"


@pytest.fixture
def environment(tmp_path: Path) -> Path:
    python = tmp_path / "lerobot" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(PYTHON.format(told=tmp_path / "told", works=tmp_path / "works"), encoding="utf-8")
    python.chmod(0o755)
    return tmp_path / "lerobot"


def test_the_dataset_is_exported_once_and_the_same_command_goes_on(
    dataset: Path, environment: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    command = TrainCommand(
        policy="act", dataset=dataset, lerobot_environment=environment, out=out, steps=7, lerobot=("batch_size=4",)
    )
    assert command.run() == 1
    assert "the same command goes on" in capsys.readouterr().out
    (tmp_path / "works").touch()
    assert command.run() == 0
    assert f"vlagents serve act --checkpoint {out / 'run'}" in capsys.readouterr().out
    first, again = (tmp_path / "told").read_text(encoding="utf-8").splitlines()
    assert (
        first
        == again
        == f"-m vlagents.policies.lerobot_train {out / 'recipe' / 'lerobot.json'} {out / 'export'} {out / 'run'} "
        "--seed=0 --steps=7 --batch_size=4"
    )
    assert json.loads((out / "export" / "meta" / "info.json").read_text(encoding="utf-8"))["total_episodes"] == 1
    with pytest.raises(InvalidSetup, match="another policy"):
        TrainCommand(policy="diffusion", dataset=dataset, lerobot_environment=environment, out=out).run()


def test_what_is_missing_is_said(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidSetup, match="give --dataset and --environment"):
        TrainCommand(policy="act").run()
    with pytest.raises(InvalidSetup, match="vlagents recipe lerobot"):
        TrainCommand(policy="act", dataset=dataset, lerobot_environment=tmp_path / "none", out=tmp_path / "run").run()
    with pytest.raises(InvalidSetup, match="belong to --policy"):
        TrainCommand(task="PickCuboid", dataset=dataset).run()
    with pytest.raises(InvalidSetup, match="give no task"):
        TrainCommand(task="PickCuboid", policy="act", dataset=dataset, lerobot_environment=tmp_path).run()
    lerobot: Any = {"policy": "act", "dataset": dataset, "lerobot_environment": tmp_path}
    with pytest.raises(InvalidSetup, match=r"learning_rate, device cannot be combined with policy.*--lerobot"):
        TrainCommand(**lerobot, learning_rate=1e-4, course=Course(device="cuda")).run()
    assert not (tmp_path / "run").exists()
