"""LeRobot's options of a run that begins, and of one that goes on; `make test-interop` trains with them."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from vlagents.policies.lerobot_train import begun, main, resumed

CPU: Any = SimpleNamespace(cuda=SimpleNamespace(is_available=lambda: False))


def test_a_run_goes_on_from_its_last_checkpoint_and_else_makes_room(tmp_path: Path) -> None:
    run = tmp_path / "run"
    assert resumed(run, []) == []
    for _ in range(3):
        run.mkdir()
        assert resumed(run, []) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.0", "run.1", "run.2"]
    config = run / "checkpoints/last/pretrained_model/train_config.json"
    config.parent.mkdir(parents=True)
    config.write_text("{}")
    assert resumed(run, ["--steps=5"]) == [f"--config_path={config}", "--resume=true", "--steps=5"]


def test_words_of_the_command_come_before_those_of_the_file(tmp_path: Path) -> None:
    file = tmp_path / "lerobot.json"
    file.write_text(json.dumps({"policy.path": "lerobot/smolvla_base", "steps": 20, "wandb.enable": False}))
    words = begun(CPU, file, tmp_path / "export", tmp_path / "run", ["--steps=5", "--seed=1"])
    assert sorted(words) == [
        f"--dataset.root={tmp_path / 'export'}",
        f"--output_dir={tmp_path / 'run'}",
        "--policy.device=cpu",
        "--policy.path=lerobot/smolvla_base",
        "--seed=1",
        "--steps=5",
        "--wandb.enable=false",
    ]


@pytest.mark.parametrize("words", [[], ["lerobot.json", "export"], ["lerobot.json", "--steps=5", "run"]])
def test_a_command_without_its_three_words_says_what_it_takes(words: list[str]) -> None:
    with pytest.raises(SystemExit, match=r"lerobot_train lerobot\.json EXPORT RUN"):
        main(words)
