"""`rcs plan`."""

from __future__ import annotations

from pathlib import Path

import av
import pytest

from rcs.cli.main import main

GOAL = ["--goal", "0.3", "-0.5", "0.0", "-2.2", "0.0", "1.6", "0.8"]


@pytest.mark.gl
@pytest.mark.parametrize("name", ["plan.mp4", "plan.png"])
def test_a_plan_is_printed_and_drawn(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / name
    with pytest.raises(SystemExit) as ended:
        main(["plan", "PickCuboid", "--planner", "EST", "--speed", "0.5", "--out", str(out), *GOAL])
    assert ended.value.code == 0
    assert "waypoints" in capsys.readouterr().out
    with av.open(str(out)) as file:
        pictures = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
    assert len(pictures) == 1 if name.endswith("png") else len(pictures) > 5
    assert pictures[0].std() > 5.0


def test_without_a_goal_it_says_what_to_give(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["plan", "PickCuboid"])
    assert ended.value.code == 1
    assert "--goal" in capsys.readouterr().err
