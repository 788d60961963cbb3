from __future__ import annotations

import hashlib
import json
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from vlagents import InvalidInput
from vlagents.cli.main import main
from vlagents.errors import MissingStack
from vlagents.policies import catalogue
from vlagents.policies.random import RandomPolicy
from vlagents.policies.settings import FILE, Settings

STACKLESS = {"random", "replay"}
"""Policies that need nothing but this package."""


def test_every_family_has_a_recipe() -> None:
    assert set(catalogue.BUILT_IN) - STACKLESS <= {*catalogue.recipes(), *catalogue.FAMILIES}
    assert catalogue.recipe("act") == catalogue.recipe("lerobot")


@pytest.mark.parametrize("family", catalogue.recipes())
def test_a_recipe_is_a_script_that_pins_versions_and_names_no_host(family: str) -> None:
    script = catalogue.recipe(family)
    subprocess.run(["sh", "-n"], input=script, text=True, check=True)
    assert f"vlagents recipe {family} | sh -s -- FOLDER" in " ".join(script.replace("#", " ").split())
    assert "3.11" in script
    assert not re.search(r"https?://|git\+|--index-url|--extra-index-url|\.org|\.com", script)


@pytest.mark.parametrize("family", catalogue.recipes())
def test_a_recipe_without_a_folder_says_so_and_makes_nothing(family: str) -> None:
    done = subprocess.run(["sh", "-s"], input=catalogue.recipe(family), text=True, capture_output=True, check=False)
    assert done.returncode != 0
    assert "name the folder of the environment" in done.stderr


def test_the_command_prints_a_recipe_and_proposes_a_near_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["recipe", "octo"]) == 0
    assert capsys.readouterr().out == catalogue.recipe("octo")
    assert main(["recipe", "octopus"]) == 1
    assert "Did you mean 'octo'?" in capsys.readouterr().err
    with pytest.raises(InvalidInput, match="openvla"):
        catalogue.recipe("../octo")


@pytest.mark.parametrize(("family", "package"), [("octo", "octo"), ("openvla", "timm"), ("vjepa2_ac", "timm")])
def test_a_missing_stack_names_the_recipe(family: str, package: str) -> None:
    error = MissingStack(family, package)
    assert f"`vlagents recipe {family}`" in str(error)
    assert repr(package) in str(error)


@pytest.mark.parametrize(("name", "family"), [("act", "act"), ("smolvla", "smolvla"), ("lerobot", "")])
def test_a_family_of_lerobots_is_checked_by_its_name(monkeypatch: pytest.MonkeyPatch, name: str, family: str) -> None:
    class Named(RandomPolicy):
        def __init__(self, checkpoint: str, *, family: str = "") -> None:
            super().__init__()
            self.made = (checkpoint, family)

    monkeypatch.setattr(catalogue, "find", lambda what, place: Named)
    made = catalogue.load(name, "runs/a")
    assert isinstance(made, Named)
    assert made.made == ("runs/a", family)


def test_settings_from_elsewhere_are_part_of_the_hash_of_a_checkpoint(tmp_path: Path) -> None:
    (tmp_path / "model.bin").write_bytes(b"weights")
    settings = Settings(dataset="pick", options={"center_crop": True})
    weights = catalogue.hash_of(tmp_path)
    assert weights == hashlib.sha256(b"model.bin\0weights").hexdigest(), "ledgers know it"
    assert catalogue.hash_of(tmp_path, Settings()) == catalogue.hash_of(tmp_path, Settings(device="cpu")) == weights
    used = catalogue.hash_of(tmp_path, settings)
    assert used == catalogue.hash_of(tmp_path, replace(settings, device="cpu"))
    other = catalogue.hash_of(tmp_path, replace(settings, options={"center_crop": False}))
    assert len({weights, used, other}) == 3


def test_settings_in_the_folder_count_once(tmp_path: Path) -> None:
    (tmp_path / FILE).write_text(json.dumps({"dataset": "pick", "rate": 10}))
    own = Settings.read(tmp_path)
    assert catalogue.hash_of(tmp_path, own) == catalogue.hash_of(tmp_path)
    assert catalogue.hash_of(tmp_path, Settings()) != catalogue.hash_of(tmp_path), "they are not those that hold"


def test_code_outside_of_the_folder_is_part_of_the_hash_of_a_checkpoint(tmp_path: Path) -> None:
    folder, code = tmp_path / "model", tmp_path / "config.py"
    folder.mkdir()
    hashes = []
    for text in ("CONFIG = 1", "CONFIG = 2"):
        for file in (code, folder / "config.py"):
            file.write_text(text)
        hashes.append(catalogue.hash_of(folder, code=code))
        assert catalogue.hash_of(folder, code=folder / "config.py") == catalogue.hash_of(folder)
        (folder / "config.py").unlink()
    assert hashes[0] != hashes[1]
