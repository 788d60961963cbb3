"""Where LeRobot's checkpoints are; `make test-interop` loads some."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from vlagents import InvalidInput
from vlagents.policies.lerobot import LerobotPolicy, find
from vlagents.policies.settings import FILE

BELOW = "checkpoints/last/pretrained_model"


@pytest.mark.parametrize("below", [".", "pretrained_model", BELOW])
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


@pytest.mark.parametrize(("places", "read"), [((".",), "run"), ((".", BELOW), "run"), ((BELOW,), "beside")])
def test_settings_in_the_folder_of_the_run_come_before_those_beside_the_weights(
    tmp_path: Path, places: tuple[str, ...], read: str
) -> None:
    (tmp_path / BELOW).mkdir(parents=True)
    (tmp_path / BELOW / "config.json").write_text("{}")
    for place in places:
        options = {"run" if place == "." else "beside": 1}
        (tmp_path / place / FILE).write_text(json.dumps({"options": options}))
    with pytest.raises(InvalidInput, match=rf"There are no options \['{read}'\]"):
        LerobotPolicy(str(tmp_path))
