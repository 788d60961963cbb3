"""The commands that edit, split, merge and mix datasets do what the functions of the same name do."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from rcs_data import Dataset, check

from rcs.cli.main import main

pytestmark = pytest.mark.gl


@pytest.fixture(scope="module")
def collected(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("collected") / "set"
    words = [
        "PickCuboid",
        "--episodes",
        "3",
        "--cameras",
        "side",
        "--image-size",
        "48",
        "--seed",
        "4",
        "--workers",
        "1",
    ]
    assert call("collect", *words, "--colour", "lossless", "--camera-noise", "--out", str(path)) == 0
    return path


@pytest.fixture
def dataset(tmp_path: Path, collected: Path) -> Path:
    return shutil.copytree(collected, tmp_path / "set")


def call(*words: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(list(words))
    return int(ended.value.code or 0)


def ids(path: Path) -> list[str]:
    return [episode.id for episode in Dataset.open(path).episodes]


def test_edits_follow_each_other_and_are_taken_back(dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, digest = str(dataset), Dataset.open(dataset).digest()
    assert Dataset.open(dataset).info.feature("observation/frames/side/rgb").encoding == "lossless"
    steps = [
        ["delete", path, "--episodes", "000001"],
        ["relabel", path, "--instruction", "heb ihn auf"],
        ["rename-camera", path, "--name", "side", "--to", "front"],
        ["trim", path, "--episode", "000000", "--first", "2", "--last", "50"],
        ["resize", path, "--size", "24", "24"],
        ["resample", path, "--frequency", "10"],
        ["keep", path, "--which", "successful"],
    ]
    for words in steps:
        assert call("data", *words) == 0, words
    opened = Dataset.open(dataset)
    assert ids(dataset) == ["000000", "000002"]
    assert (opened.info.frequency, opened.info.instruction) == (10, "heb ihn auf")
    assert opened.episodes[0].column("observation/frames/front/rgb").shape == (17, 24, 24, 3)
    assert check(dataset).is_ok
    capsys.readouterr()
    assert call("data", "history", path) == 0
    told = capsys.readouterr().out
    assert all(words[0] in told for words in steps)
    for _ in steps:
        assert call("data", "undo", path) == 0
    assert Dataset.open(dataset).digest() == digest
    assert call("data", "undo", path) == 1
    assert "nothing to undo" in capsys.readouterr().err
    assert call("data", "prune", path) == 0
    assert check(dataset).is_ok


def test_an_undo_says_what_it_has_undone(dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    call("data", "relabel", str(dataset), "--instruction", "lift it")
    call("data", "delete", str(dataset), "--episodes", "000001")
    at = Dataset.open(dataset).history[-1].at
    assert "Undo: `rcs-data undo" in capsys.readouterr().out
    call("data", "undo", str(dataset))
    first, second = capsys.readouterr().out.splitlines()
    assert first == f"Undid delete with episodes=000001, of {at}."
    assert second.startswith("3 episodes, ")
    assert second.endswith(" at 30 Hz.")
    call("data", "undo", str(dataset))
    assert capsys.readouterr().out.startswith("Undid relabel with instruction=lift it, of ")


def test_split_merge_and_mix(dataset: Path, tmp_path: Path) -> None:
    parts, merged, mixed = tmp_path / "parts", tmp_path / "merged", tmp_path / "mixed"
    assert call("data", "split", str(dataset), "--out", str(parts), "--parts", "train=0.67", "val=0.33") == 0
    assert (len(ids(parts / "train")), len(ids(parts / "val"))) == (2, 1)
    assert call("data", "merge", str(parts / "train"), str(parts / "val"), "--out", str(merged)) == 0
    assert Dataset.open(merged).digest() == Dataset.open(dataset).digest()
    words = [
        "data",
        "mix",
        f"{parts / 'train'}:1",
        f"{dataset}:2",
        "--out",
        str(mixed),
        "--seed",
        "3",
        "--frequency",
        "6",
    ]
    assert call(*words, "--rename", "train/side=front", "set/side=front") == 0
    opened = Dataset.open(mixed)
    assert len(opened) == 3
    assert {episode.source["dataset"] for episode in opened.episodes if episode.source} == {"train", "set"}
    assert check(mixed).is_ok
    assert np.isfinite(opened.episodes[0].column("observation/joints")).all()


@pytest.mark.parametrize(
    "words",
    [
        ["delete"],
        ["delete", "--episodes", "x", "--which", "failed"],
        ["delete", "--episodes", "nothing"],
        ["trim", "--episode", "000000", "--first", "10000"],
        ["resample", "--frequency", "60"],
        ["split", "--out", "OUT", "--parts", "train=many"],
        ["mix", "--out", "OUT", "--rename", "side=front"],
    ],
)
def test_what_makes_no_sense_is_told_and_nothing_changes(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    before = Dataset.open(dataset).history
    filled = [str(tmp_path / "out") if word == "OUT" else word for word in words]
    assert call("data", filled[0], str(dataset), *filled[1:]) == 1
    assert "InvalidSetup" in capsys.readouterr().err
    assert Dataset.open(dataset).history == before
    assert not (tmp_path / "out").exists()


def test_the_history_shows_both_ends_of_a_list_of_episodes(dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("data", "relabel", str(dataset), "--instruction", "lift it", "--episodes", *ids(dataset)) == 0
    capsys.readouterr()
    assert call("data", "history", str(dataset)) == 0
    assert "000000 … 000002 (3)" in " ".join(capsys.readouterr().out.split())
