from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from vlagents import Chunk, InvalidInput, Metadata, Observation
from vlagents.metadata import PartSpec
from vlagents.policies import catalogue
from vlagents.policies.sessions import SessionPolicy
from vlagents.policies.settings import FILE, Settings, check_parts, chosen


def test_a_folder_without_a_file_has_the_defaults(tmp_path: Path) -> None:
    assert Settings.read(tmp_path) == Settings()
    with pytest.raises(InvalidInput, match="cannot be read"):
        Settings.read(tmp_path, tmp_path / "missing.json")


def test_settings_are_read_from_the_checkpoint_or_another_file(tmp_path: Path) -> None:
    given = {
        "dataset": "pick",
        "images": {"image_primary": "side"},
        "state": [{"name": "joints", "size": 7, "unit": "rad"}],
        "rate": 10,
        "options": {"samples": 5},
    }
    (tmp_path / FILE).write_text(json.dumps(given))
    (tmp_path / "other.json").write_text(json.dumps({"dataset": "place"}))
    settings = Settings.read(tmp_path)
    assert settings.state == (PartSpec("joints", 7, "rad"),)
    assert (settings.camera("image_primary"), settings.camera("image_wrist")) == ("side", "image_wrist")
    assert Settings.read(tmp_path, tmp_path / "other.json").dataset == "place"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ([], "list"),
        ({"data_set": "x"}, "dataset, data_hash, images, state"),
        ({"dataset": 1}, "dataset.*Expected `str`, got `int`"),
        ({"images": ["side"]}, "images.*Expected `object`, got `array`"),
        ({"images": {"image": 3}}, "images.*Expected `str`, got `int`"),
        ({"rate": float("nan")}, "rate"),
        ({"rate": True}, "rate.*got `bool`|Expected `float`, got `bool`.*rate"),
        ({"state": [{"name": "joints", "size": 0}]}, "size"),
        ({"state": "joints"}, "Expected `array`, got `str`.*state"),
    ],
)
def test_a_wrong_setting_is_named_with_what_is_valid(tmp_path: Path, given: Any, said: str) -> None:
    (tmp_path / FILE).write_text(json.dumps(given))
    with pytest.raises(InvalidInput, match=said):
        Settings.read(tmp_path)


def test_statistics_of_another_dataset_are_never_taken() -> None:
    assert chosen("", ["pick"]) == "pick"
    assert chosen("place", ["pick", "place"]) == "place"
    for dataset, known in (("", ["pick", "place"]), ("bridge", ["pick"]), ("", [])):
        with pytest.raises(InvalidInput, match="statistics of"):
            chosen(dataset, known)


def test_parts_must_have_as_many_numbers_as_the_model() -> None:
    check_parts("state", (PartSpec("joints", 7), PartSpec("gripper", 1)), 8)
    with pytest.raises(InvalidInput, match=r"joints \(7\), 7 together"):
        check_parts("state", (PartSpec("joints", 7),), 8)


def test_options_keep_their_type() -> None:
    settings = Settings(options={"reach": 1, "crop": "yes"})
    assert settings.option("reach", 0.5) == 1.0
    assert settings.option("samples", 400) == 400
    with pytest.raises(InvalidInput, match="valid is a bool"):
        settings.option("crop", False)
    with pytest.raises(InvalidInput, match="crop"):
        settings.check_options(("reach",))


class Remembering(SessionPolicy[list[int]]):
    def infer(self, observation: Observation) -> Chunk:
        raise NotImplementedError

    def _begin(self, seed: int | None) -> list[int]:
        return [seed or 0]


def test_sessions_remember_apart_and_forget() -> None:
    policy = Remembering(Metadata("Octo", ()))
    policy.reset("left", "push", seed=3)
    left, right = (policy._session(Observation(session=name)) for name in ("left", "right"))
    left.memory.append(4)
    assert (left.memory, right.memory) == ([3, 4], [0])
    assert policy._instruction(Observation(session="left")) == "push"
    assert policy._instruction(Observation(session="left", instruction="lift")) == "lift"
    with pytest.raises(InvalidInput, match="Octo needs an instruction"):
        policy._instruction(Observation(session="right"))
    policy.forget("left")
    assert policy._session(Observation(session="left")).memory == [0]


def test_policies_without_settings_refuse_them(tmp_path: Path) -> None:
    (tmp_path / "settings.json").write_text("{}")
    with pytest.raises(InvalidInput, match="has no option --settings"):
        catalogue.load("random", "7", tmp_path / "settings.json")
