from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from rcs.data import CheckReport, check
from rcs.robots.fr3.description import FR3

if TYPE_CHECKING:
    from conftest import MakeMoving, Rows

JOINTS = "observation/joints"
UNKNOWN: dict[str, Any] = {"robot": "one of our own", "stepping": "realtime", "cameras": ["wrist"]}


def spike(by: float) -> Any:
    def change(rows: Rows) -> None:
        rows[40][JOINTS] = rows[40][JOINTS] + by * np.eye(7)[2]

    return change


def found(report: CheckReport) -> list[tuple[str, tuple[int, int] | None]]:
    return [(finding.kind, finding.rows) for finding in report.findings]


def test_a_step_beyond_the_velocity_limit_is_a_jump(tmp_path: Path, moving: MakeMoving) -> None:
    limit = FR3.velocity_limit[2] / 30
    assert found(check(moving(tmp_path / "slow", spike(0.9 * limit)))) == []
    report = check(moving(tmp_path / "fast", spike(2 * limit)))
    assert found(report) == [("joint_jump", (40, 41))]
    assert "faster than Franka Research 3 can" in report.findings[0].message


def test_a_step_that_took_longer_may_be_longer(tmp_path: Path, moving: MakeMoving) -> None:
    def pause(rows: Rows) -> None:
        for row in rows[40:]:
            row["time/monotonic"] += 0.2
            row["time/frames/wrist"] += 0.2
            row[JOINTS] = row[JOINTS] + 0.3

    assert found(check(moving(tmp_path, pause))) == [("time_gap", (40, 40))]


@pytest.mark.parametrize(("by", "is_found"), [(0.1, False), (0.6, True)])
def test_of_an_unknown_robot_a_jump_is_what_is_out_of_proportion(
    tmp_path: Path, moving: MakeMoving, by: float, is_found: bool
) -> None:
    report = check(moving(tmp_path, spike(by), setup=UNKNOWN))
    assert found(report) == ([("joint_jump", (40, 41))] if is_found else [])
    (note,) = report.notes
    assert "one of our own" in note


def test_an_unknown_robot_may_start_and_stop_at_once(tmp_path: Path, moving: MakeMoving) -> None:
    def jerk(rows: Rows) -> None:
        for i, row in enumerate(rows):
            row[JOINTS] = rows[0][JOINTS] + 0.1 * np.clip(i - 40, 0, 20)

    assert found(check(moving(tmp_path, jerk, setup=UNKNOWN))) == []


def test_joints_beyond_their_limits_are_named(tmp_path: Path, moving: MakeMoving) -> None:
    def shift(rows: Rows) -> None:
        by = FR3.joint_upper[3] + 0.1 - rows[0][JOINTS][3]
        for row in rows:
            row[JOINTS] = row[JOINTS] + by * np.eye(7)[3]

    (finding,) = check(moving(tmp_path, shift)).findings
    assert finding.kind == "joint_limit"
    assert f"{FR3.joints[3]} up to" in finding.message
    assert FR3.joints[2] not in finding.message


def test_the_arms_of_a_lab_are_known_by_the_names_in_its_keys(tmp_path: Path) -> None:
    from rcs.data import DatasetInfo, Feature
    from rcs.data.check.arms import find_arms

    features = tuple(Feature(key=f"observation/{s}/joints", shape=(7,), dtype="float64") for s in ("left", "other"))
    info = DatasetInfo(frequency=30, features=features, setup={"robot": "dual_fr3"}, instruction="lift")
    arms, notes = find_arms(info)
    assert arms == {"observation/left/joints": FR3}
    assert len(notes) == 1
    assert "observation/other/joints" in notes[0]
