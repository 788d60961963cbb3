"""The configuration of a trainer names what our export for it really has."""

from __future__ import annotations

import ast
import json
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature
from rcs_data.cli.convert import RecipeCommand
from rcs_data.convert import ExportOptions, export_lerobot, export_rlds
from rcs_data.convert.recipe.recipe import Family, Recipe, recipe
from rcs_data.errors import InvalidSetup
from vlagents.policies.settings import Settings

Make = Callable[..., Path]


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """Return a function that records a dataset of one short episode."""

    def made(
        control: str = "xyzrpy", relative: str = "last_step", cameras: tuple[str, ...] = ("wrist", "side")
    ) -> Path:
        size = {"xyzrpy": 6, "joints": 7, "tquat": 7}[control]
        parts = {
            "observation/joints": (7, "rad"),
            "observation/gripper": (1, "0 closed, 1 open"),
            f"action/{control}": (size, "rad" if control == "joints" else "m, rad"),
            "action/gripper": (1, "0 closed, 1 open"),
        }
        features = [Feature(key=key, shape=(n,), dtype="float64", unit=unit) for key, (n, unit) in parts.items()]
        frames = [f"observation/frames/{name}/rgb" for name in cameras]
        features += [Feature(key=key, shape=(32, 48, 3), dtype="uint8", encoding="jpeg") for key in frames]
        info = DatasetInfo(
            frequency=10.0,
            features=tuple(features),
            setup={"robot": "fr3", "control": control, "relative": relative},
            instruction="pick up the cuboid",
        )
        path = tmp_path / f"{control} {relative} {len(cameras)}" / "Pick it!"
        with DatasetWriter.open(path, info) as writer, writer.episode("000000", seed=0) as episode:
            for row in range(4):
                values: dict[str, Any] = {
                    key: np.full(n, 0.1 * row) for key, (n, _) in parts.items() if row or key.startswith("observation")
                }
                episode.add(values | {key: np.full((32, 48, 3), row, np.uint8) for key in frames})
            episode.finish(True)
        return path

    return made


def assigned(text: str) -> dict[str, Any]:
    """Return the values that a file of Python gives names to, where they are written out."""
    found = {}
    for node in ast.parse(text).body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            try:
                found[node.targets[0].id] = ast.literal_eval(node.value)
            except ValueError:
                continue
    return found


def code(made: Recipe) -> str:
    (text,) = (text for name, text in made.files.items() if name != "vlagents.json")
    return text


@pytest.mark.parametrize("family", get_args(Family))
def test_what_is_written_is_python_and_settings_that_vlagents_reads(family: Family, make: Make) -> None:
    dataset = Dataset.open(make())
    made = recipe(family, dataset)
    settings = Settings.from_dict(json.loads(made.files["vlagents.json"]))
    assert (settings.dataset, settings.rate) == ("pick_it", 10.0)
    assert settings.data_hash == dataset.digest()
    assert [(part.name, part.size, part.unit, part.meaning) for part in settings.action] == [
        ("xyzrpy", 6, "m, rad", "delta"),
        ("gripper", 1, "0 closed, 1 open", "absolute"),
    ]
    assert set(settings.images.values()) == ({"side"} if family == "openvla" else {"side", "wrist"})
    assert settings.options == {} or family in ("openpi", "openvla")
    if family in ("act", "diffusion", "smolvla"):
        assert json.loads(code(made))["dataset.repo_id"] == "rcs/pick_it"
    else:
        compile(code(made), family, "exec")
        assert "pick up the cuboid" in code(made)


def test_openpi_is_told_the_columns_of_our_lerobot_export(make: Make, tmp_path: Path) -> None:
    dataset = Dataset.open(make())
    export_lerobot(dataset, tmp_path / "out", ExportOptions(), version="2.1")
    features = json.loads((tmp_path / "out/meta/info.json").read_text())["features"]
    said = assigned(code(recipe("openpi", dataset)))
    assert set(said["COLUMNS"].values()) == {name for name in features if name.startswith("observation.images.")}
    assert [said["STATE_SIZE"], said["ACTION_SIZE"]] == [
        features["observation.state"]["shape"][0],
        features["action"]["shape"][0],
    ]
    assert said["SLOTS"] == {"base_0_rgb": "observation/side", "left_wrist_0_rgb": "observation/wrist"}
    settings = json.loads(recipe("openpi", dataset).files["vlagents.json"])
    assert set(settings["images"]) == set(said["COLUMNS"]) == set(said["SLOTS"].values())


def test_lerobot_is_told_how_long_a_second_is_and_where_the_pictures_are(make: Make) -> None:
    found = Dataset.open(make("joints", "absolute"))
    options = json.loads(recipe("act", found).files["lerobot.json"])
    assert (options["policy.type"], options["policy.chunk_size"], options["dataset.repo_id"]) == (
        "act",
        10,
        "rcs/pick_it",
    )
    settings = Settings.from_dict(json.loads(recipe("act", found).files["vlagents.json"]))
    assert settings.images == {"wrist": "wrist", "side": "side"}
    assert [part.name for part in settings.state] == ["joints", "gripper"]
    with pytest.raises(InvalidSetup, match="no camera"):
        recipe("act", Dataset.open(make(cameras=())))


@pytest.mark.parametrize("family", ["octo", "openvla"])
def test_octo_and_openvla_are_told_the_names_of_our_rlds_export(family: Family, make: Make, tmp_path: Path) -> None:
    dataset = Dataset.open(make())
    report = export_rlds(dataset, tmp_path / "out")
    steps = json.loads((report.path / "features.json").read_text())["featuresDict"]["features"]["steps"]
    known = steps["sequence"]["feature"]["featuresDict"]["features"]
    pictures = known["observation"]["featuresDict"]["features"]
    text = code(recipe(family, dataset))
    if family == "octo":
        said = assigned(text)
        assert said["IMAGES"] == {"primary": "image_side", "wrist": "image_wrist"}
        assert set(said["IMAGES"].values()) <= set(pictures)
        assert said["MASK"] == [True] * 6 + [False]
        assert str(said["ACTION_SIZE"]) == known["action"]["tensor"]["shape"]["dimensions"][0]
    else:
        assert "'image_side'" in text
        assert "image_side" in pictures
    assert "language_instruction" in known
    assert f'"{report.path.parent.name}"' in text  # the export's folder is its name


@pytest.mark.parametrize(
    ("relative", "meaning"), [("absolute", "absolute"), ("origin", "relative"), ("last_step", "delta")]
)
def test_the_setup_says_what_an_action_counts_from(relative: str, meaning: str, make: Make) -> None:
    made = recipe("openpi", Dataset.open(make("joints", relative)))
    action = json.loads(made.files["vlagents.json"])["action"]
    assert [(part["name"], part["meaning"]) for part in action] == [("joints", meaning), ("gripper", "absolute")]
    # Joints that are absolute become relative to the state, which has them in the same place.
    delta = assigned(code(made))["DELTA"]
    assert delta == ([True] * 7 if meaning == "absolute" else None)


def test_poses_are_never_subtracted(make: Make) -> None:
    assert assigned(code(recipe("openpi", Dataset.open(make("tquat", "absolute")))))["DELTA"] is None


def test_actions_of_unknown_meaning_are_refused(make: Make) -> None:
    with pytest.raises(InvalidSetup, match="absolute, origin, last_step"):
        recipe("act", Dataset.open(make("joints", "sometimes")))


def test_openvla_refuses_what_it_would_not_load(make: Make) -> None:
    for control, relative in (("joints", "last_step"), ("xyzrpy", "absolute")):
        with pytest.raises(InvalidSetup, match="--control xyzrpy, and without --relative absolute"):
            recipe("openvla", Dataset.open(make(control, relative)))


def test_a_dataset_without_pictures_and_one_with_too_many_are_refused(make: Make) -> None:
    with pytest.raises(InvalidSetup, match="no camera"):
        recipe("octo", Dataset.open(make(cameras=())))
    with pytest.raises(InvalidSetup, match="see three"):
        recipe("openpi", Dataset.open(make(cameras=("a", "b", "c", "d"))))


def test_octo_without_a_wrist_camera_drops_what_looks_at_it(make: Make) -> None:
    assert assigned(code(recipe("octo", Dataset.open(make(cameras=("side",))))))["IMAGES"]["wrist"] is None


def test_the_command_writes_the_files_and_says_how_to_go_on(
    make: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    path, out = make(), tmp_path / "what it needs"
    assert RecipeCommand(family="octo", path=path, out=Path(out.name), cameras=("side",)).run() == 0
    printed = capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {"octo_config.py", "vlagents.json"}
    assert f"rcs-data export {shlex.quote(str(path))} " in printed
    assert f"--config {shlex.quote(str(out))}/octo_config.py" in printed
    assert "--cameras side" in printed
    assert "vlagents serve octo" in printed
