from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rcs_data import CheckReport, DatasetInfo, Feature, JointBounds, check

if TYPE_CHECKING:
    from conftest import MakeMoving, Rows

JOINTS = "observation/joints"


def spike(by: float) -> Any:
    def change(rows: Rows) -> None:
        rows[40][JOINTS] = rows[40][JOINTS] + by * np.eye(7)[2]

    return change


def without_limits(info: DatasetInfo) -> tuple[Feature, ...]:
    return tuple(replace(feature, limits=None) for feature in info.features)


def found(report: CheckReport) -> list[tuple[str, tuple[int, int] | None]]:
    return [(finding.kind, finding.rows) for finding in report.findings]


def test_a_step_beyond_the_velocity_limit_is_a_jump(tmp_path: Path, moving: MakeMoving, arm: JointBounds) -> None:
    limit = arm.velocity[2] / 30
    assert found(check(moving(tmp_path / "slow", spike(0.9 * limit)))) == []
    report = check(moving(tmp_path / "fast", spike(2 * limit)))
    assert found(report) == [("joint_jump", (40, 41))]
    assert "faster than an arm of tests can" in report.findings[0].message


def test_a_step_that_took_longer_may_be_longer(tmp_path: Path, moving: MakeMoving) -> None:
    def pause(rows: Rows) -> None:
        for row in rows[40:]:
            row["time/monotonic"] += 0.2
            row["time/frames/wrist"] += 0.2
            row[JOINTS] = row[JOINTS] + 0.3

    assert found(check(moving(tmp_path, pause))) == [("time_gap", (40, 40))]


@pytest.mark.parametrize(("by", "is_found"), [(0.1, False), (0.6, True)])
def test_of_an_unknown_robot_a_jump_is_what_is_out_of_proportion(
    tmp_path: Path, moving: MakeMoving, moving_info: DatasetInfo, by: float, is_found: bool
) -> None:
    report = check(moving(tmp_path, spike(by), features=without_limits(moving_info)))
    assert found(report) == ([("joint_jump", (40, 41))] if is_found else [])
    (note,) = report.notes
    assert "'observation/joints' is not compared with limits" in note


def test_an_unknown_robot_may_start_and_stop_at_once(
    tmp_path: Path, moving: MakeMoving, moving_info: DatasetInfo
) -> None:
    def jerk(rows: Rows) -> None:
        for i, row in enumerate(rows):
            row[JOINTS] = rows[0][JOINTS] + 0.1 * np.clip(i - 40, 0, 20)

    assert found(check(moving(tmp_path, jerk, features=without_limits(moving_info)))) == []


def test_joints_beyond_their_limits_are_named(tmp_path: Path, moving: MakeMoving, arm: JointBounds) -> None:
    def shift(rows: Rows) -> None:
        by = arm.upper[3] + 0.1 - rows[0][JOINTS][3]
        for row in rows:
            row[JOINTS] = row[JOINTS] + by * np.eye(7)[3]

    (finding,) = check(moving(tmp_path, shift)).findings
    assert finding.kind == "joint_limit"
    assert f"{arm.names[3]} up to" in finding.message
    assert arm.names[2] not in finding.message
