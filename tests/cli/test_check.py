"""`rcs data check` on the command line: its exit codes, its lines, its JSON, its repair."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature

from rcs.cli.main import main


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    path = tmp_path / "a [bold] dataset"
    features = (Feature(key="observation/joints", shape=(2,), dtype="float64"),)
    info = DatasetInfo(frequency=30, features=features, setup={}, instruction="wave")
    with DatasetWriter.open(path, info) as writer:
        for name in ("a", "b [red]"):
            with writer.episode(name, seed=0) as episode:
                for i in range(50):
                    episode.add({"observation/joints": np.full(2, i / 100)})
                episode.finish(True)
    return path


def call(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    with pytest.raises(SystemExit) as stopped:
        main(["data", "check", *arguments])
    return int(stopped.value.code or 0), capsys.readouterr().out


def flip(dataset: Path, name: str) -> None:
    path = Dataset.open(dataset)[name].path / "steps.parquet"
    data = bytearray(path.read_bytes())
    data[len(data) // 3] ^= 16
    path.write_bytes(bytes(data))


def test_a_whole_dataset_is_told_in_a_line_and_exit_code_0(capsys: pytest.CaptureFixture[str], dataset: Path) -> None:
    code, told = call(capsys, str(dataset))
    assert code == 0
    assert told.splitlines() == [
        "note: 'observation/joints' is not compared with limits: the dataset has none for it.",
        "2 episodes, 100 rows, 0 images checked: no damage",
    ]


def test_damage_is_a_line_and_exit_code_1(capsys: pytest.CaptureFixture[str], dataset: Path) -> None:
    flip(dataset, "b [red]")
    code, told = call(capsys, str(dataset))
    assert code == 1
    (line,) = [line for line in told.splitlines() if line.startswith("damage")]
    assert "episodes/b [red]/steps.parquet" in line
    assert told.splitlines()[-1].endswith("damage in 1 place of 1 episode")


def test_warnings_are_exit_code_0_but_when_strict(capsys: pytest.CaptureFixture[str], dataset: Path) -> None:
    info = Dataset.open(dataset).info
    with DatasetWriter.open(dataset, info, resume=True) as writer, writer.episode("c", seed=0) as episode:
        episode.add({"observation/joints": np.zeros(2)})
        episode.finish(None)
    code, told = call(capsys, str(dataset), "--depth", "bytes")
    assert (code, "2 warnings" in told) == (0, True)
    assert call(capsys, str(dataset), "--strict")[0] == 1


def test_json_is_one_document_with_all_there_is_to_know(capsys: pytest.CaptureFixture[str], dataset: Path) -> None:
    flip(dataset, "a")
    code, told = call(capsys, str(dataset), "--json")
    document = json.loads(told)
    assert code == 1
    assert (document["path"], document["episodes"], document["repair"]) == (str(dataset), 2, None)
    assert (document["damage"], document["warnings"]) == (1, 0)
    (finding,) = document["findings"]
    assert finding.keys() == {"severity", "kind", "episode", "file", "message", "rows"}
    assert (finding["severity"], finding["episode"], finding["file"]) == ("damage", "a", "episodes/a/steps.parquet")


def test_a_repair_is_told_and_what_is_left_is_checked(capsys: pytest.CaptureFixture[str], dataset: Path) -> None:
    flip(dataset, "a")
    code, told = call(capsys, str(dataset), "--repair")
    assert code == 0
    assert told.startswith("quarantined episode a: damaged; its files are in quarantine/a")
    assert [episode.id for episode in Dataset.open(dataset)] == ["b [red]"]
    flip(dataset, "b [red]")
    code, told = call(capsys, str(dataset), "--repair", "--json")
    assert (code, [done["what"] for done in json.loads(told)["repair"]]) == (0, ["quarantined"])
    assert "nothing to repair" in call(capsys, str(dataset), "--repair")[1]


@pytest.mark.parametrize("form", [(), ("--json",)])
def test_a_repair_of_what_a_killed_merge_left_in_place_of_a_dataset_ends_well(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, form: tuple[str, ...]
) -> None:
    (tmp_path / ".merged.partial-12ab").mkdir()
    (tmp_path / ".merged.partial-12ab.lock").touch()
    code, told = call(capsys, str(tmp_path / "merged"), "--repair", *form)
    assert (code, ".merged.partial-12ab, left by a killed program" in told) == (0, True)
    assert list(tmp_path.iterdir()) == []
    assert call(capsys, str(tmp_path / "merged"), "--repair", *form)[0] == 1, "there is no dataset"
