"""`rcs eval`: figures, videos, Ctrl-C."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rcs.cli.main import main

RCS = [sys.executable, "-c", "from rcs.cli.main import main; main()"]


def call(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    with pytest.raises(SystemExit) as stopped:
        main(["eval", *arguments])
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out + captured.err


@pytest.mark.gl
def test_it_tells_the_rate_and_leaves_figures_and_videos(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    options = ("--episodes", "3", "--videos", "1", "--workers", "1", "--out", str(tmp_path / "e"))
    code, told = call(capsys, "PickCuboid", *options)
    assert code == 0
    assert "3 of 3 = 100.0 % (95 % Wilson interval" in told
    assert sorted(path.name for path in (tmp_path / "e").iterdir()) == ["000000.mp4", "evaluation.json"]
    assert json.loads((tmp_path / "e" / "evaluation.json").read_text())["success_rate"] == 1.0


def test_options_of_the_task_and_layers_are_part_of_the_setup(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    options = ("--task-options", "lift_height=0.05", "hold_time=0.5", "--reward", "sparse")
    layers = ("--layers", "rcs.envs.layers:BinaryGripper", "--frequency", "20", "--relative", "absolute")
    code, told = call(
        capsys, "PickCuboid", *options, *layers, "--episodes", "1", "--workers", "1", "--out", str(tmp_path)
    )
    assert code == 0, told
    setup = json.loads((tmp_path / "evaluation.json").read_text())["setup"]
    assert setup["task_options"] == {"lift_height": 0.05, "hold_time": 0.5}
    assert (setup["reward"], setup["discount"]) == ("sparse", 0.99)
    assert setup["layers"] == ["rcs.envs.layers:BinaryGripper"]
    assert (setup["frequency"], setup["relative"]) == (20.0, "absolute")


def test_no_evaluation_is_mixed_with_another(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for folder in ("evaluation", "evaluation-2", "evaluation-3"):
        code, told = call(capsys, "PickCuboid", "--episodes", "1", "--workers", "1")
        assert code == 0
        assert f"{folder}/evaluation.json" in told
    before = (tmp_path / "evaluation" / "evaluation.json").read_bytes()
    code, told = call(capsys, "PickCuboid", "--episodes", "2", "--workers", "1", "--out", "evaluation")
    assert code == 1
    assert "evaluation is not empty" in told
    assert "another --out" in told
    assert (tmp_path / "evaluation" / "evaluation.json").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["PickCuboid", "--agent", "PickExpart"], ["PickExpart", "Did you mean 'PickExpert'"]),
        (["PickCuboid", "--layers", "BinaryGriper"], ["BinaryGriper"]),
        (["PickCuboid", "--task-options", "hold_time"], ["'hold_time'", "name=value"]),
        (["PickCuboid", "--task-options", "hold_tyme=1"], ["hold_tyme", "valid: lift_height, hold_time"]),
        (["PickCuboid", "--task-options", "reward=sparse"], ["no option of a task but of the setup"]),
        (["PickCuboid", "--reward", "dense", "--discount", "1"], ["discount is 1"]),
        (["PickCuboid", "--videos", "-1"], ["videos is -1"]),
        (["PickCuboid", "--workers", "-1"], ["workers is -1"]),
        (["Free"], ["no scripted expert"]),
    ],
)
def test_bad_arguments_get_a_clear_error_and_leave_nothing(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, arguments: list[str], words: list[str]
) -> None:
    code, told = call(capsys, "--workers", "1", *arguments, "--out", str(tmp_path / "e"))
    assert code == 1
    assert "Traceback" not in told
    for word in words:
        assert word in told.replace("\n", " ")
    assert not (tmp_path / "e").exists()


@pytest.mark.gl
@pytest.mark.skipif(os.name != "posix", reason="signals are POSIX's")
@pytest.mark.parametrize("workers", ["1", "2"])
def test_ctrl_c_ends_after_the_episodes_at_work_and_keeps_the_figures(tmp_path: Path, workers: str) -> None:
    options = ["PickCuboid", "--episodes", "500", "--videos", "2", "--workers", workers, "--out", str(tmp_path)]
    process = subprocess.Popen(
        [*RCS, "eval", *options], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )
    end = time.monotonic() + 60.0
    while not (tmp_path / "000001.mp4").exists() and process.poll() is None and time.monotonic() < end:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    told, _ = process.communicate(timeout=60)
    assert process.returncode == 130, told
    assert "Ending after the episodes at work" in told
    assert "Traceback" not in told
    figures = json.loads((tmp_path / "evaluation.json").read_text())
    assert 1 <= figures["episodes"] < 500
    assert figures["judged"] == len(figures["results"])
