"""Where LeRobot's checkpoints are; `make test-interop` loads some."""

from __future__ import annotations

from pathlib import Path

import pytest
from vlagents import InvalidInput
from vlagents.policies.lerobot import find


@pytest.mark.parametrize("below", [".", "pretrained_model", "checkpoints/last/pretrained_model"])
def test_a_checkpoint_is_found_in_its_folder_and_in_that_of_the_run(tmp_path: Path, below: str) -> None:
    folder = tmp_path / below
    folder.mkdir(parents=True, exist_ok=True)
    with pytest.raises(InvalidInput, match=r"config\.json"):
        find(str(tmp_path))
    (folder / "config.json").write_text("{}")
    assert find(str(tmp_path)) == folder


def test_no_name_is_no_checkpoint_even_beside_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "config.json").write_text("{}")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidInput, match="checkpoint is ''"):
        find("")
