"""`rcs compare`: which agents are compared unasked, and which by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def test_agents_of_different_tasks_are_compared_by_name_alone(call_unwrapped: Any, tmp_path: Path) -> None:
    for task in ("PickCuboid", "Push"):
        options = ("--episodes", "1", "--max-episode-steps", "2", "--workers", "1", "--out", str(tmp_path))
        assert call_unwrapped("eval", task, *options, "--name", task.lower())[0] == 0
    code, told = call_unwrapped("compare", str(tmp_path))
    assert code == 0, told
    assert "pickcuboid" in told
    assert "No two of them have task, robot and domain in common" in told
    assert "differ on" not in told
    assert not (tmp_path / "comparison.html").exists()
    assert "differ on 1 shared seeds" in call_unwrapped("compare", str(tmp_path), "pickcuboid", "push")[1]
    assert (tmp_path / "comparison.html").exists()
