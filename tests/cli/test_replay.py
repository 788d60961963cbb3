"""`rcs data replay` in its four modes: what it prints, what it leaves, and what it refuses."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rcs_data import Dataset

from rcs.cli.main import main
from rcs.cli.replay import successes_in_words
from rcs.rollout.reexecute import ReexecutionResult


@pytest.mark.gl
def test_render_makes_a_dataset_with_frames(call: Any, dataset: Path, tmp_path: Path) -> None:
    options = ["--kind", "render", "--out", str(tmp_path / "new"), "--cameras", "wrist", "side", "--image-size", "32"]
    code, told = call("data", "replay", str(dataset), *options, "--workers", "1")
    assert code == 0
    assert "2 episodes rendered" in told
    keys = [feature.key for feature in Dataset.open(tmp_path / "new").info.features]
    assert "observation/frames/wrist/rgb" in keys
    assert "observation/frames/side/rgb" in keys


def test_actions_prints_deviations(call: Any, dataset: Path, tmp_path: Path) -> None:
    code, told = call(
        "data", "replay", str(dataset), "--kind", "actions", "--workers", "1", "--out", str(tmp_path / "new")
    )
    assert code == 0
    assert "2 of 2 succeed in simulation" in told
    assert "joints [mrad]" in told
    assert "0.00/0.00" in told
    assert all("…" not in line for line in told.splitlines()), "nothing is cut off"
    assert f"Dataset: {tmp_path / 'new'}" in told.replace("\n", "")
    assert len(Dataset.open(tmp_path / "new")) == 2


def test_states_counts_what_succeeds_in_simulation(call: Any, dataset: Path, tmp_path: Path) -> None:
    code, told = call(
        "data", "replay", str(dataset), "--kind", "states", "--out", str(tmp_path / "new"), "--workers", "1"
    )
    assert code == 0
    assert "2 of 2 succeed in simulation" in told
    assert len(Dataset.open(tmp_path / "new")) == 2


def test_a_check_names_no_dataset_that_it_would_have_made(call: Any, dataset: Path) -> None:
    code, told = call("data", "replay", str(dataset))
    assert code == 0
    assert "2 of 2 episodes bit-equal" in told
    assert "Dataset:" not in told


@pytest.mark.parametrize("kind", ["check", "actions", "states"])
def test_json_is_json_and_nothing_else(
    capsys: pytest.CaptureFixture[str], dataset: Path, tmp_path: Path, kind: str
) -> None:
    out = [] if kind == "check" else ["--out", str(tmp_path / "new"), "--workers", "1"]
    with pytest.raises(SystemExit):
        main(["data", "replay", str(dataset), "--kind", kind, "--json", *out])
    told = json.loads(capsys.readouterr().out)
    assert told["kind"] == kind
    assert len(told["episodes"]) == 2
    if kind == "actions":
        rows = told["episodes"][0]["rows"]["joints"]
        assert len(rows) == told["episodes"][0]["recorded_steps"] + 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--kind", "render"], "--out"),
        (["--render-quality", "full"], "--render-quality has no meaning for --kind check"),
        (["--out", "x"], "--out has no meaning for --kind check"),
        (["--workers", "2"], "--workers has no meaning for --kind check"),
        (["--kind", "actions", "--out", "x", "--task", "Push"], "--task has no meaning for --kind actions"),
        (["--kind", "render", "--out", "x", "--cameras", "wirst"], "Did you mean 'wrist'"),
        (["--kind", "states", "--out", "x", "--task", "PickCubiod"], "Did you mean 'PickCuboid'"),
    ],
)
def test_what_makes_no_sense_is_refused_and_leaves_nothing(
    call: Any,
    dataset: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    code, told = call("data", "replay", str(dataset), *arguments)
    assert code == 1
    assert words in told.replace("\n", " ")
    assert "Traceback" not in told
    assert list(tmp_path.iterdir()) == []


def test_the_summary_counts_successes_and_episodes_that_could_not_be_replayed() -> None:
    made = ReexecutionResult(episode_id="a", recorded_success=True, success=True)
    failed = replace(made, recorded_success=False, success=False)
    assert successes_in_words([made, failed]) == "1 of 2 succeed in simulation; of 1 recorded successes 1"
    lost = replace(failed, problem="no poses")
    assert successes_in_words([made, made, lost]).endswith("; of 2 recorded successes 2; 1 could not be replayed")
    assert successes_in_words([made]) == "1 of 1 succeed in simulation"
