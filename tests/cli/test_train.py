"""`rcs train`: it trains, goes on, and says what is wrong; `rcs eval` and `rcs collect` take what it leaves."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rcs_data.ledger import Ledger

from rcs.cli.main import main
from rcs.cli.setup_options import Flags
from rcs.cli.teleop import TeleopCommand
from rcs.rl.checkpoint import find_checkpoint

pytestmark = pytest.mark.extras

RCS = [sys.executable, "-c", "from rcs.cli.main import main; main()"]
SMALL = (
    "--steps", "240", "--copies", "2", "--episodes", "2", "--evaluate-every", "120", "--max-episode-steps", "6",
    "--control", "joints", "--frequency", "30", "--threads", "1", "--torch-threads", "1",
)  # fmt: skip


def newest(run: Path) -> int:
    """Return the steps of the newest checkpoint; -1 for none."""
    return max((int(path.name) for path in run.glob("checkpoints/0*")), default=-1)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small training, by the command."""
    out = tmp_path_factory.mktemp("runs") / "x"
    with pytest.raises(SystemExit) as stopped:
        main(["train", "PickCuboid", "--out", str(out), *SMALL, "--no-video"])
    assert stopped.value.code == 0
    return out


def test_it_leaves_checkpoints_figures_and_a_page(run: Path) -> None:
    assert sorted(path.name for path in run.iterdir() if not path.name.startswith(".")) == [
        "checkpoints", "metrics.jsonl", "report.html",
    ]  # fmt: skip
    page = (run / "report.html").read_text("utf-8")
    assert "PickCuboid on fr3" in page
    assert "http" not in re.sub(r"data:[^\"]*", "", page)  # nothing is loaded from elsewhere


def test_the_same_command_and_resume_find_it_done(call_unwrapped: Any, run: Path) -> None:
    for words in (["train", "PickCuboid", "--out", str(run), *SMALL, "--no-video"], ["train", "--resume", str(run)]):
        code, told = call_unwrapped(*words)
        assert code == 0
        assert f"{newest(run)} steps in" in told
        assert f"Report: {run / 'report.html'}" in told


def test_a_checkpoint_is_evaluated_in_its_own_environment(call_unwrapped: Any, run: Path, tmp_path: Path) -> None:
    code, told = call_unwrapped("eval", str(run), "--episodes", "3", "--out", str(tmp_path / "a"))
    assert code == 0, told
    best = find_checkpoint(run)
    weights = best.files["policy.pt"]
    words = f"{run.name}@{best.steps} at {best.path}, weights {weights[:16]}"
    assert "".join(words.split()) in "".join(told.split())  # wrapped at any place
    assert "a batch of 3 copies" in told
    ledger = Ledger(tmp_path / "a")
    (condition,) = ledger.conditions.values()
    assert (condition.weights, condition.trained) == (weights, best.steps)
    assert condition.setup["max_episode_steps"] == 6
    assert condition.setup["observe"] == ["privileged", "contacts"]
    assert [row.steps for row in ledger.rows.values()] == [6, 6, 6]
    out = tmp_path / "b"
    code, told = call_unwrapped("eval", "PickCuboid", "--agent", str(run), "--episodes", "3", "--out", str(out))
    assert code == 0, told
    assert Ledger(out).rows.keys() == ledger.rows.keys()
    assert [row.reward for row in Ledger(out).rows.values()] == [row.reward for row in ledger.rows.values()]


def test_another_agent_is_evaluated_in_the_environment_of_a_checkpoint(
    call_unwrapped: Any, run: Path, tmp_path: Path
) -> None:
    options = ("--agent", "PickExpert", "--episodes", "1", "--workers", "1", "--out", str(tmp_path))
    code, told = call_unwrapped("eval", str(run), *options)
    assert code == 0, told
    assert [(row.agent, row.steps) for row in Ledger(tmp_path).rows.values()] == [("PickExpert", 6)]


def test_a_person_who_takes_over_from_a_checkpoint_is_not_bound_to_the_length_of_its_episodes(run: Path) -> None:
    assert TeleopCommand(task=str(run))._setup().max_episode_steps is None
    assert TeleopCommand(task="PickCuboid", agent=str(run))._setup().max_episode_steps is None
    limited: Any = replace(Flags(), max_episode_steps=9)
    assert TeleopCommand(task=str(run), environment=limited)._setup().max_episode_steps == 9


@pytest.mark.gl
@pytest.mark.parametrize(
    ("cameras", "seen"), [((), ["side", "wrist"]), (("--cameras", "wrist"), ["wrist"]), (("--cameras", "none"), [])]
)
def test_what_it_does_is_recorded_with_cameras_that_it_does_not_need(
    call_unwrapped: Any, run: Path, tmp_path: Path, cameras: tuple[str, ...], seen: list[str]
) -> None:
    options = ("--episodes", "1", "--workers", "1", "--image-size", "64", "--no-report", *cameras)
    code, told = call_unwrapped("collect", str(run), *options, "--out", str(tmp_path / "d"))
    assert code == 0, told
    from rcs_data import Dataset

    dataset = Dataset.open(tmp_path / "d")
    assert sorted(dataset.info.setup["cameras"]["names"]) == seen
    assert [episode.length for episode in dataset] == [7]


@pytest.mark.gl
def test_a_policy_that_sees_and_its_videos(call_unwrapped: Any, tmp_path: Path) -> None:
    run, short = tmp_path / "run", ("--steps", "40", "--evaluate-every", "40", "--image-size", "40")
    code, told = call_unwrapped("train", "PickCuboid", "--out", str(run), *SMALL, *short, "--cameras", "wrist", "side")
    assert code == 0, told
    assert sorted(path.stem for path in (run / "videos").iterdir()) == ["000000000", f"{newest(run):09d}"]
    assert "data:video/mp4;base64," in (run / "report.html").read_text("utf-8")
    options = ("--episodes", "1", "--videos", "1", "--workers", "1", "--out", str(tmp_path / "e"))
    code, told = call_unwrapped("eval", str(run), *options)
    assert code == 0, told
    ledger = Ledger(tmp_path / "e")
    (row,) = ledger.rows.values()
    assert ledger.film(row).is_file(), told
    assert ledger.condition(row.condition).setup["cameras"]["names"] == ["wrist", "side"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["train"], ["Give a task", "--resume RUN"]),
        (["train", "PickCubiod"], ["PickCubiod", "Did you mean 'PickCuboid'"]),
        (["train", "PickCuboid", "--copies", "-1"], ["copies is -1"]),
        (["train", "PickCuboid", "--robot", "fr4"], ["fr4", "Did you mean 'fr3'"]),
        (["train", "--resume", "nothing/here"], ["There is no training in nothing/here"]),
        (["train", "PickCuboid", "--resume", "x"], ["With --resume, give neither a task nor --out"]),
        (["eval", "nothing/here"], ["There is no checkpoint in nothing/here"]),
        (["eval", "PickCuboid", "--agent", "nothing/here"], ["There is no checkpoint in nothing/here"]),
    ],
)
def test_what_is_wrong_is_said(call_unwrapped: Any, tmp_path: Path, arguments: list[str], words: list[str]) -> None:
    out = ["--out", str(tmp_path / "x")] if "--resume" not in arguments and len(arguments) > 1 else []
    code, told = call_unwrapped(*arguments, *out)
    assert code == 1
    assert "Traceback" not in told
    for word in words:
        assert word in told
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["Free"], "Free has no reward"),
        (["StackCuboid", "--algorithm", "dagger"], "has one for PickCuboid, Place, not for 'StackCuboid'"),
        (
            ["PickCuboid", "--algorithm", "dagger", "--robot", "xarm7"],
            "the lab of 'xarm7' lacks; it has front. Choose with",
        ),
        (["PickCuboid", "--device", "tpu"], "device is 'tpu', on which torch cannot compute here; valid is cpu"),
        (["Nope"], "no task named 'Nope'"),
    ],
)
def test_what_cannot_be_trained_is_refused_before_anything_else_is_said(
    call_unwrapped: Any, tmp_path: Path, arguments: list[str], told: str
) -> None:
    code, said = call_unwrapped("train", *arguments, "--out", str(tmp_path / "run"))
    assert code == 1
    assert said.startswith("error: ")
    assert told in said
    assert not (tmp_path / "run").exists()


def test_options_that_contradict_a_checkpoint_are_refused(call_unwrapped: Any, run: Path, tmp_path: Path) -> None:
    out = ("--episodes", "1", "--out", str(tmp_path))
    code, told = call_unwrapped("eval", str(run), "--robot", "ur5e", *out)
    assert (code, "robot is 'ur5e', not 'fr3'" in told) == (1, True), told
    code, told = call_unwrapped("eval", "Push", "--agent", str(run), *out)
    assert (code, "was trained for PickCuboid, not for Push" in told) == (1, True), told
    code, told = call_unwrapped("train", "PickCuboid", "--out", str(run), *SMALL, "--seed", "1")
    assert (code, "another training began: seed is 1, not 0" in told) == (1, True), told


def test_without_torch_the_extra_is_named(call_unwrapped: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    code, told = call_unwrapped("train", "PickCuboid", "--out", str(tmp_path / "x"))
    assert (code, "pip install 'robot-control-stack[rl]'" in told) == (1, True), told


@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX's")
def test_ctrl_c_ends_with_a_checkpoint_and_the_same_command_goes_on(tmp_path: Path) -> None:
    run = tmp_path / "run"
    command = [*RCS, "train", "PickCuboid", "--out", str(run), *SMALL, "--no-video", "--steps", "100000"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    end = time.monotonic() + 90.0
    while newest(run) <= 0 and process.poll() is None and time.monotonic() < end:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    told, _ = process.communicate(timeout=60)
    assert process.returncode == 130, told
    assert "Ending after the running update" in told
    assert "Traceback" not in told
    assert f"{newest(run)} steps in" in told
