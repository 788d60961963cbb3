"""`rcs train --seeds`: several trainings at a time, on a cluster of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rcs.cli.main import main

COMMAND = (
    "train", "PickCuboid", "--seeds", "0", "3", "--copies", "2", "--episodes", "2", "--max-episode-steps", "6",
    "--control", "joints", "--frequency", "30", "--no-video",
)  # fmt: skip
SHORT = ("--steps", "240", "--evaluate-every", "120")


def start(out: Path, *more: str) -> subprocess.Popen[str]:
    plain = {key: value for key, value in os.environ.items() if not key.startswith("RAY_")}
    return subprocess.Popen(
        [sys.executable, "-c", "from rcs.cli.main import main; main()", *COMMAND, *more, "--out", str(out)],
        env=plain,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


@pytest.mark.cluster
def test_each_seed_has_a_run_and_the_same_command_finds_them_done(tmp_path: Path) -> None:
    for _ in range(2):
        with start(tmp_path / "runs", *SHORT) as process:
            told, _ = process.communicate(timeout=240)
        assert process.returncode == 0, told
        assert "240/240" in told and told.count("done in") >= 2 and "success" in told
        for seed in (0, 3):
            run = tmp_path / "runs" / f"seed-{seed}"
            assert (run / "report.html").exists() and (run / "checkpoints/000000240").exists()


@pytest.mark.cluster
def test_ctrl_c_ends_and_the_same_command_goes_on(tmp_path: Path) -> None:
    out = tmp_path / "runs"
    long = ("--steps", "1000000", "--evaluate-every", "1000")
    with start(out, *long) as process:
        end = time.monotonic() + 200
        while len(list(out.glob("seed-*/checkpoints/000002*"))) < 2 and time.monotonic() < end:
            assert process.poll() is None
            time.sleep(0.2)
        os.killpg(process.pid, signal.SIGINT)
        told, _ = process.communicate(timeout=100)
    assert process.returncode == 130 and "the same command goes on" in told and "Traceback" not in told, told


@pytest.mark.extras
@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--seeds", "0", "0"), "[0, 0]; valid is one or more, all different"),
        (("--ray-address", "auto"), "give --seeds with --ray-address"),
    ],
)
def test_what_is_wrong_is_said(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, words: tuple[str, ...], told: str
) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["train", "PickCuboid", "--out", str(tmp_path / "runs"), *words])
    captured = capsys.readouterr()
    assert stopped.value.code == 1 and told in " ".join((captured.out + captured.err).split())
    assert not (tmp_path / "runs").exists()
