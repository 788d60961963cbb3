"""Episodes that the scripted experts collect with every robot have no finding: no damage, and no false alarm."""

from __future__ import annotations

from pathlib import Path

import pytest
from rcs_data import check

import rcs
from rcs.rollout.collect import collect
from rcs.rollout.collection import Collection, Progress

SETUPS = {
    "fr3": {"cameras": rcs.Cameras(names=("wrist", "side"), image_size=64, depth=True)},
    "ur5e": {"cameras": rcs.Cameras(names="wrist", image_size=64), "control": "tquat"},
    "so101": {"cameras": rcs.Cameras(names=("wrist", "diagonal"), image_size=64, fps=15.0)},
    "dual_fr3": {"task": "LiftBar", "cameras": rcs.Cameras(names="left_wrist", image_size=64)},
    "xarm7": {"task": "PickToy", "cameras": rcs.Cameras(names="front", image_size=64), "randomisation": True},
}


@pytest.mark.gl
@pytest.mark.parametrize("robot", SETUPS)
def test_the_episodes_of_the_scripted_expert_have_no_finding(tmp_path: Path, robot: str) -> None:
    setup = rcs.Setup(**{"task": "PickCuboid", "robot": robot, **SETUPS[robot]})  # type: ignore[arg-type]
    episodes = 2
    list(collect(Collection(setup=setup, out=tmp_path / "set", episodes=episodes, seed=1), Progress()))
    report = check(tmp_path / "set")
    assert (report.episodes, report.notes) == (episodes, ())
    assert report.frames > 50
    assert not report.findings, str(report)


@pytest.mark.gl
def test_the_touch_of_a_sensor_has_no_finding(tmp_path: Path) -> None:
    setup = rcs.Setup(tactile="digit")
    list(collect(Collection(setup=setup, out=tmp_path / "set", episodes=1, seed=1), Progress()))
    report = check(tmp_path / "set")
    assert report.frames > 50
    assert not report.findings, str(report)
