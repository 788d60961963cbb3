from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from rcs_data import DatasetInfo, Feature, check, edit
from rcs_data.files.flags import FrameFlag

if TYPE_CHECKING:
    from conftest import MakeMoving, Rows

TIME = "time/monotonic"


def delay(first: int, seconds: float) -> Any:
    """A change of rows: from one on, everything is later."""

    def change(rows: Rows) -> None:
        for row in rows[first:]:
            row[TIME] += seconds
            row["time/frames/wrist"] += seconds

    return change


def found(path: Path) -> list[tuple[str, tuple[int, int] | None]]:
    return [(finding.kind, finding.rows) for finding in check(path).findings]


def test_a_steady_recording_has_no_finding(tmp_path: Path, moving: MakeMoving) -> None:
    report = check(moving(tmp_path))
    assert not report.findings, str(report)
    assert not report.notes


def test_a_gap_is_located_and_its_missing_steps_counted(tmp_path: Path, moving: MakeMoving) -> None:
    (finding,) = check(moving(tmp_path, delay(40, 0.1))).findings
    assert (finding.kind, finding.rows, finding.severity) == ("time_gap", (40, 40), "warning")
    assert finding.message == "1 gap, the longest 0.133 s; about 3 steps missing"


@pytest.mark.parametrize("seconds", [-0.04, -3600.0])
def test_a_clock_that_goes_backwards_is_located(tmp_path: Path, moving: MakeMoving, seconds: float) -> None:
    kinds = found(moving(tmp_path, delay(40, seconds)))
    assert kinds.count(("time_backwards", (40, 40))) == 2, "the loop's clock and the camera's"


def test_a_loop_that_does_not_keep_its_rate_is_told(tmp_path: Path, moving: MakeMoving) -> None:
    def change(rows: Rows) -> None:
        for i, row in enumerate(rows):
            row[TIME] += 0.005 * (-1) ** i

    (finding,) = check(moving(tmp_path, change)).findings
    assert finding.kind == "time_jitter"
    assert "off by 10.0 ms" in finding.message


def test_a_simulation_that_computes_slower_than_real_time_is_no_gap(
    tmp_path: Path, moving: MakeMoving, moving_info: DatasetInfo
) -> None:
    def change(rows: Rows) -> None:
        for i, row in enumerate(rows):
            row[TIME] = 10 + 3.7 * i + (i % 5) / 10
            row["time/frames/wrist"] = row[TIME] - 0.001
            row["simulated_time"] = i / 30

    features = (*moving_info.features, Feature(key="simulated_time", shape=(), dtype="float64"))
    setup = {"robot": "fr3", "stepping": "async", "cameras": ["wrist"]}
    assert found(moving(tmp_path, change, features=features, setup=setup)) == []


@pytest.mark.parametrize(
    ("flag", "kind"),
    [
        (FrameFlag.STALE, "stale"),
        (FrameFlag.MISSING, "missing_frames"),
        (FrameFlag.DROPPED, "dropped_frames"),
        (FrameFlag.REPEATED, None),
    ],
)
def test_flags_of_frames_are_counted(tmp_path: Path, moving: MakeMoving, flag: FrameFlag, kind: str | None) -> None:
    def change(rows: Rows) -> None:
        for row in rows[10:14:2]:
            row["flags/frames/wrist"] = int(flag)
            row["observation/frames/wrist/rgb"] = None

    assert found(moving(tmp_path, change)) == ([] if kind is None else [(kind, (10, 12))])


@pytest.mark.parametrize("frequency", [29.0, 25.0, 20.0, 7.0, 5.0])
def test_a_lower_rate_is_no_gap(tmp_path: Path, moving: MakeMoving, frequency: float) -> None:
    path = moving(tmp_path)
    edit.resample(path, frequency)
    assert found(path) == []


def test_a_row_without_a_time_is_no_gap(tmp_path: Path, moving: MakeMoving) -> None:
    def change(rows: Rows) -> None:
        rows[5][TIME] = None

    assert found(moving(tmp_path, change)) == []
