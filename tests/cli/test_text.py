"""Commands print what is stored as it is stored, and end without a traceback."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, Feature

from rcs.cli.main import main
from rcs.devices import lookup

STRANGE = "[/bold] [red]x[/red] :smile: \x1b[31m"


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    path = tmp_path / "set"
    feature = Feature(key="observation/[/joints]", shape=(1,), dtype="float64", unit="[/rad]")
    action = Feature(key="action/joints", shape=(1,), dtype="float64")
    info = DatasetInfo(frequency=10, features=(feature, action), setup={"note": STRANGE}, instruction=STRANGE)
    with DatasetWriter.open(path, info) as writer:
        for number, success in enumerate((True, False, None)):
            with writer.episode(f"[bold]{number}", seed=0) as episode:
                episode.add({feature.key: np.zeros(1)})
                episode.add({feature.key: np.zeros(1), "action/joints": np.zeros(1)})
                episode.finish(success, {"failure": STRANGE if success is False else None})
    return path


def call(*words: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(list(words))
    return int(ended.value.code or 0)


def test_words_are_printed_and_are_no_markup(dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(dataset)
    assert call("data", "relabel", path, "--instruction", STRANGE, "--episodes", "[bold]1") == 0
    for words in (["info"], ["history"], ["check"], ["view"], ["recover"]):
        capsys.readouterr()
        assert call("data", words[0], path) == 0, words
        told = capsys.readouterr().out
        assert "\x1b[31m" not in told
        if words[0] == "info":
            assert "[/bold] [red]x[/red] :smile: \ufffd[31m" in told
    assert call("data", "split", path, "--out", str(tmp_path / "[/out]"), "--parts", "[a]=0.5", "b=0.5") == 0
    assert call("data", "delete", path, "--episodes", "[/nothing]") == 1
    assert "There is no episode [/nothing]" in capsys.readouterr().err


def test_info_rates_only_what_was_judged(dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("data", "info", str(dataset)) == 0
    told = capsys.readouterr().out
    assert "1 of 2 judged = 50.0 % (95 % Wilson interval 9.5 to 90.5 %)" in told
    assert "not judged   1" in told
    assert call("data", "keep", str(dataset), "--which", "unjudged") == 0
    assert [episode.success for episode in Dataset.open(dataset)] == [None]
    capsys.readouterr()
    assert call("data", "info", str(dataset)) == 0
    told = capsys.readouterr().out
    assert "success      not judged" in told
    assert "0.0 %" not in told


def test_a_task_without_words_is_listed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    find: Callable[[str, str], Any] = lookup.find
    wordless = type("Wordless", (), {})
    monkeypatch.setattr(lookup, "find", lambda kind, name: wordless if kind == "task" else find(kind, name))
    assert call("list") == 0
    assert "PickCuboid" in capsys.readouterr().out


@pytest.mark.parametrize(
    "words",
    [
        ["data", "info", "/dev/null"],
        ["data", "info", "a\udcff"],
        ["data", "check", "/proc/self/mem"],
        ["data", "view", "SET", "--out", "/dev/null/x"],
        ["data", "import", "/dev/null", "--out", "OUT"],
        ["data", "import", "OUT", "--out", "OUT", "--format", "lerobot"],
        ["data", "export", "SET", "--out", "/proc/x", "--format", "lerobot-v3"],
        ["data", "export", "SET", "--out", "OUT", "--format", "[/x]"],
        ["data", "relabel", "SET", "--instruction", "\udcff"],
        ["data", "resample", "SET", "--frequency", "nan"],
        ["data", "mix", "SET:9" * 3000, "--out", "OUT"],
        ["data", "merge", "SET", "--out", "x" * 300],
        ["data", "split", "SET", "--out", "OUT", "--parts", "a=nan"],
        ["collect", "[/x]", "--out", "OUT"],
        ["collect", "PickCuboid", "--out", "/dev/null/x", "--episodes", "1", "--cameras", "none"],
        ["collect", "PickCuboid", "--out", "OUT", "--camera-fps", "nan"],
        ["collect", "PickCuboid", "--out", "OUT", "--image-size", "-3"],
        ["collect", "PickCuboid", "--out", "OUT", "--seed", "-1"],
    ],
)
def test_bad_input_is_an_error_and_no_traceback(
    dataset: Path, tmp_path: Path, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    given = [word.replace("SET", str(dataset)).replace("OUT", str(tmp_path / "out")) for word in words]
    assert call(*given) in (1, 2)
    assert "error" in capsys.readouterr().err.lower()
