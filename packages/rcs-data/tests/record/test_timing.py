"""The timing report names gaps, freezes and repeats, and invents no time."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rcs_data import DatasetWriter, Feature

if TYPE_CHECKING:
    from conftest import MakeInfo, MakeRows

STATE = 5  # the sim_state_size of make_info


def timing_of(path: Path, info: Any, rows: list[dict[str, Any]]) -> dict[str, Any]:
    with DatasetWriter.open(path, info) as writer, writer.episode("a", seed=0) as episode:
        for row in rows:
            episode.add(row, np.zeros(STATE))
        return episode.finish(None).timing


def test_a_steady_recording_has_no_gap(tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows) -> None:
    timing = timing_of(tmp_path, make_info(images=True), make_rows(31, images=True))
    period = timing["period"]
    assert timing["rows"] == 31
    assert period["mean"] == pytest.approx(1 / 30)
    assert period["jitter_max"] < 1e-9
    assert (period["gaps"], period["missed_steps"], period["backwards"]) == (0, 0, 0)
    assert timing["cameras"]["observation/frames/wrist/rgb"] == {
        "new_images": 31,
        "repeated_images": 0,
        "repeated_captures": 0,
        "longest_freeze": 0,
    }


def test_a_pause_of_four_periods_is_one_gap_with_three_missed_steps(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows
) -> None:
    rows = make_rows(10)
    for row in rows[5:]:
        row["time/monotonic"] += 3 / 30
    period = timing_of(tmp_path, make_info(), rows)["period"]
    assert (period["gaps"], period["missed_steps"]) == (1, 3)
    assert period["max"] == pytest.approx(4 / 30)


def test_a_clock_that_runs_backwards_is_counted(tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows) -> None:
    rows = make_rows(4)
    rows[2]["time/monotonic"] = 0.0
    assert timing_of(tmp_path, make_info(), rows)["period"]["backwards"] == 1


def test_a_frozen_camera_is_counted_by_image_and_by_capture_time(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows
) -> None:
    rows = make_rows(9, images=True)
    for row in rows[3:6]:
        row["observation/frames/wrist/rgb"] = rows[2]["observation/frames/wrist/rgb"]
        row["time/frames/wrist"] = rows[2]["time/frames/wrist"]
    cameras = timing_of(tmp_path, make_info(images=True), rows)["cameras"]
    assert cameras["observation/frames/wrist/rgb"] == {
        "new_images": 9,
        "repeated_images": 3,
        "repeated_captures": 3,
        "longest_freeze": 3,
    }
    assert cameras["observation/frames/wrist/depth"]["repeated_images"] == 0


@pytest.mark.parametrize("rate", [20.0, 60.0, 1000.0])
def test_a_gap_of_a_device_is_one_that_the_loop_has_seen(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows, rate: float
) -> None:
    """At 50 Hz, of a sensor that gives nothing for 0.2 s, twice; the second time, its rows have no time at all."""
    rows = make_rows(200)
    for i, row in enumerate(rows):
        row["time/monotonic"] = 100 + i / 50
        moment = i // 50 if 50 <= i < 60 or 100 <= i < 110 else i / 50
        row["time/frames/wrist"] = None if 100 < i < 110 else 100 + np.floor(moment * rate + 1e-6) / rate
        row["time/command"] = row["time/monotonic"] - 0.02
    info = make_info(frequency=50.0)
    info = replace(info, features=(*info.features, Feature(key="time/command", shape=(), dtype="float64", unit="s")))
    devices = timing_of(tmp_path, info, rows)["devices"]
    assert devices.keys() == {"frames/wrist"}
    assert devices["frames/wrist"]["gaps"] == 2
    assert devices["frames/wrist"]["rate"] == pytest.approx(min(rate, 50.0), rel=0.15)


def test_the_clock_of_a_device_is_known_by_its_offset_and_drift(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows
) -> None:
    rows = make_rows(60)
    for i, row in enumerate(rows):
        row["time/device/frames/wrist"] = 7.0 + i / 30 * (1 - 1e-4)
        row["time/frames/wrist"] = 100.0 + i / 30
    info = make_info()
    key = "time/device/frames/wrist"
    info = replace(info, features=(*info.features, Feature(key=key, shape=(), dtype="float64", unit="s")))
    clock = timing_of(tmp_path, info, rows)["devices"]["frames/wrist"]["clock"]
    assert clock["offset"] == pytest.approx(93.0, abs=1e-6)
    assert clock["drift"] == pytest.approx(1e-4, rel=1e-3)


def test_times_that_were_not_measured_are_left_out(tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows) -> None:
    rows = make_rows(5)
    for row in rows:
        row["time/monotonic"] = None
    assert timing_of(tmp_path, make_info(), rows)["period"] is None
