"""`rcs compare`: which agents are compared unasked, and which by name."""

from __future__ import annotations

from pathlib import Path

import pytest

from rcs.cli.main import main


def call(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as stopped:
        main(list(arguments))
    captured = capsys.readouterr()
    assert not stopped.value.code, captured
    return " ".join(captured.out.split())


def test_agents_of_different_tasks_are_compared_by_name_alone(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for task in ("PickCuboid", "Push"):
        options = ("--episodes", "1", "--max-episode-steps", "2", "--workers", "1", "--out", str(tmp_path))
        call(capsys, "eval", task, *options, "--name", task.lower())
    told = call(capsys, "compare", str(tmp_path))
    assert "pickcuboid" in told
    assert "No two of them have task, robot and domain in common" in told
    assert "differ on" not in told
    assert not (tmp_path / "comparison.html").exists()
    assert "differ on 1 shared seeds" in call(capsys, "compare", str(tmp_path), "pickcuboid", "push")
    assert (tmp_path / "comparison.html").exists()
