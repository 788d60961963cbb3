"""A recording for the Rerun viewer holds the numbers and images of the dataset, at their rows and times."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset
from rcs_data.errors import DatasetError, InvalidSetup, MissingDependency
from rcs_data.view.rerun import write_rerun


def test_without_rerun_the_extra_is_named(filmed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingDependency, match=r"rcs-data\[rerun\]"):
        write_rerun(filmed, tmp_path / "a.rrd")


@pytest.mark.extras
class TestWithRerun:
    @pytest.fixture(autouse=True)
    def needs_rerun(self) -> None:
        pytest.importorskip("rerun", reason="rerun-sdk is not installed; it is half a gigabyte, so nothing installs it")

    def test_the_file_is_what_rerun_expects(self, filmed: Path, tmp_path: Path) -> None:
        path = tmp_path / "new/a.rrd"
        assert write_rerun(filmed, path) == 3
        command = [sys.executable, "-m", "rerun", "rrd", "verify", str(path)]
        subprocess.run(command, check=True, timeout=60, capture_output=True)
        assert [file.name for file in path.parent.iterdir()] == ["a.rrd"]

    def test_numbers_and_images_come_back(self, filmed: Path, tmp_path: Path) -> None:
        chunk = pytest.importorskip("rerun.chunk", reason="this version of rerun-sdk cannot read what it writes")
        told: list[tuple[int, int]] = []
        write_rerun(filmed, tmp_path / "a.rrd", episodes=["00000[01]"], on_progress=lambda *at: told.append(at))
        assert told == [(1, 2), (2, 2)]
        columns: dict[str, list[dict[str, Any]]] = {}
        for piece in chunk.RrdReader(tmp_path / "a.rrd").stream():
            rows = piece.to_record_batch()
            wanted = [name for name in rows.schema.names if name in ("row", "time") or ":" in name]
            rows = rows.select([name for name in wanted if name != "RecordingInfo:start_time"])
            if "time" in wanted:  # in nanoseconds, which Python's own durations do not have
                rows = rows.set_column(rows.schema.get_field_index("time"), "time", rows["time"].cast("int64"))
            columns.setdefault(piece.entity_path, []).extend(rows.to_pylist())
        first, second = Dataset.open(filmed).episodes[:2]
        joints = {row["row"]: row for row in columns["/observation/joints"]}
        assert sorted(joints) == list(range(first.length + second.length))
        # The second episode begins half a second after the end of the first one.
        start = 1e9 * (first.length / 30 + 0.5)
        np.testing.assert_allclose([joints[0]["time"], joints[first.length]["time"]], [0, start], atol=1e3)
        expected = np.concatenate([first.column("observation/joints"), second.column("observation/joints")])
        np.testing.assert_array_equal([joints[row]["Scalars:scalars"] for row in sorted(joints)], expected)
        assert len(columns["/action/joints"]) == first.length + second.length - 2  # resets have no action
        images = sorted(columns["/observation/frames/side/rgb"], key=lambda row: row["row"])
        stored = [*first.encoded_frames("observation/frames/side/rgb")]
        assert [bytes(row["EncodedImage:blob"][0]) for row in images[: first.length]] == stored
        words = [row["TextLog:text"][0] for row in sorted(columns["/episode"], key=lambda row: row["row"])]
        assert words == ["000000: pick it up (success)", "000001: pick it up (failure)"]

    def test_what_is_there_is_not_overwritten(self, filmed: Path, tmp_path: Path) -> None:
        (tmp_path / "a.rrd").write_text("mine")
        with pytest.raises(DatasetError, match="exists already"):
            write_rerun(filmed, tmp_path / "a.rrd")
        with pytest.raises(InvalidSetup, match="named 'x'"):
            write_rerun(filmed, tmp_path / "b.rrd", episodes=["x"])
        assert [file.name for file in tmp_path.iterdir()] == ["a.rrd"]
