"""A repair keeps all that can be read, changes nothing else, hides nothing, and can be undone."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from rcs_data import Dataset, DatasetWriter, check, edit
from rcs_data.check.repair import Mending, repair
from rcs_data.durable import sealed, unsealed
from rcs_data.errors import DatasetError
from rcs_data.flags import FrameFlag
from rcs_data.layout import new_trash_folder, open_folder
from rcs_data.lock import DatasetLock

if TYPE_CHECKING:
    from conftest import MakeInfo, MakeMoving, MakeRows, Rows

STATE = 5
ID = "000001"
RGB = "observation/frames/wrist/rgb"


def file(dataset: Path, name: str = "steps.parquet") -> Path:
    return Dataset.open(dataset)[ID].path / name


def only(dataset: Path) -> Mending:
    (mending,) = repair(dataset).mendings
    return mending


def scribble(path: Path, start: int, size: int = 64) -> None:
    data = bytearray(path.read_bytes())
    data[start : start + size] = bytes(byte ^ 0x5A for byte in data[start : start + size])
    path.write_bytes(bytes(data))


def test_a_whole_dataset_is_left_alone(dataset: Path) -> None:
    before = {path: path.read_bytes() for path in dataset.rglob("*") if path.is_file()}
    report = repair(dataset)
    assert (report.mendings, str(report)) == ((), "nothing to repair")
    assert {path: path.read_bytes() for path in dataset.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("how", ["damaged", "gone"])
@pytest.mark.parametrize("name", ["dataset.json", "dataset.copy.json"])
def test_of_two_descriptions_one_is_made_from_the_other(dataset: Path, name: str, how: str) -> None:
    edit.delete(dataset, ["000000"])
    path = dataset / name
    data = path.read_bytes()
    path.unlink() if how == "gone" else path.write_bytes(data[:-20])
    assert len(Dataset.open(dataset)) == 2
    assert only(dataset).what == "restored"
    assert path.read_bytes() == data
    assert (dataset / "quarantine" / f"{name}-1").exists() == (how == "damaged")
    assert not check(dataset).findings


def test_a_recording_goes_on_where_only_the_copy_is_left(dataset: Path, make_info: MakeInfo) -> None:
    (dataset / "dataset.json").unlink()
    with DatasetWriter.open(dataset, make_info(images=True), resume=True) as writer:
        assert writer.info.instruction == "pick the cuboid"
    with pytest.raises(DatasetError, match="already is a dataset"):
        DatasetWriter.open(dataset, make_info(images=True))
    assert len(Dataset.open(dataset)) == 3


def test_two_descriptions_that_are_lost_are_told(dataset: Path) -> None:
    for name in ("dataset.json", "dataset.copy.json"):
        scribble(dataset / name, 100)
    assert only(dataset).what == "failed"
    assert len(check(dataset).damage) == 2


def test_an_old_copy_is_made_anew_by_the_next_writer(dataset: Path, make_info: MakeInfo) -> None:
    old = (dataset / "dataset.copy.json").read_bytes()
    edit.relabel(dataset, "push")
    (dataset / "dataset.copy.json").write_bytes(old)
    assert [(f.kind, f.severity) for f in check(dataset).findings] == [("stale_copy", "warning")]
    DatasetWriter.open(dataset, make_info(images=True, instruction="push"), resume=True).close()
    assert not check(dataset).findings


def test_what_a_killed_writer_left_is_recovered_and_removed(
    dataset: Path, make_info: MakeInfo, make_rows: MakeRows
) -> None:
    with DatasetWriter.open(dataset, make_info(images=True), resume=True) as writer:
        episode = writer.episode("late", seed=0)
        for row in make_rows(4, images=True):
            episode.add(row, np.zeros(STATE))
    new_trash_folder(dataset, "gone").mkdir()
    (dataset / "generations/0001").mkdir(parents=True)
    assert {f.kind for f in check(dataset).findings} == {"left_open", "left_over"}
    mending = only(dataset)
    assert (mending.what, mending.episode) == ("recovered", "late")
    assert Dataset.open(dataset)["late"].length == 4
    assert not list(dataset.rglob("*gone*")) and not (dataset / "generations/0001").exists()
    assert {f.kind for f in check(dataset).findings} == {"no_verdict"}


def test_an_open_episode_that_cannot_be_recovered_is_out_of_the_way(
    dataset: Path, tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows
) -> None:
    with DatasetWriter.open(tmp_path / "else", make_info(sim_state_size=None)) as writer:
        writer.episode("late", seed=0).add(make_rows(1)[0])
    shutil.copytree(open_folder(tmp_path / "else", "late"), open_folder(dataset, "late"))
    mending = only(dataset)
    assert (mending.what, mending.episode) == ("quarantined", "late")
    assert (dataset / "quarantine/open-late-1/rows.arrows").exists()
    assert not check(dataset).findings
    edit.delete(dataset, [ID])


def test_a_repair_is_an_edit_that_can_be_undone(dataset: Path) -> None:
    path = file(dataset)
    scribble(path, 1000)
    damaged = path.read_bytes()
    repair(dataset)
    assert [line.command for line in Dataset.open(dataset).head.history] == ["repair"]
    edit.undo(dataset)
    assert file(dataset).read_bytes() == damaged
    assert not check(dataset).is_ok
    assert repair(dataset).mendings[0].what != "failed"
    assert check(dataset).is_ok


def test_the_damaged_files_outlive_a_prune_with_what_was_found(dataset: Path) -> None:
    path = file(dataset)
    scribble(path, 1000)
    damaged = path.read_bytes()
    repair(dataset)
    assert any("known from a repair" in note for note in check(dataset).notes)
    edit.prune(dataset)
    kept = dataset / "quarantine" / f"{ID}-1"
    assert (kept / "steps.parquet").read_bytes() == damaged
    assert json.loads((kept / "findings.json").read_text())[0]["kind"] == "altered"
    assert not any("known from a repair" in note for note in check(dataset).notes)


def test_an_episode_of_which_nothing_reads_is_only_in_quarantine(dataset: Path) -> None:
    path = file(dataset)
    path.write_bytes(b"nothing")
    mending = only(dataset)
    assert (mending.what, mending.episode) == ("quarantined", ID)
    assert [e.id for e in Dataset.open(dataset).episodes] == ["000000", "000002"]
    assert (dataset / "quarantine" / f"{ID}-1" / "steps.parquet").read_bytes() == b"nothing"


def test_a_wrong_timing_report_is_computed_anew(dataset: Path) -> None:
    path = file(dataset, "episode.json")
    about = unsealed(path.read_bytes(), path)
    wrong = {**about["timing"], "rows": 99, "writer": {"dropped_images": 0}}
    path.write_bytes(sealed({**about, "timing": wrong}))
    (finding,) = check(dataset).findings
    assert (finding.kind, finding.severity) == ("timing", "warning")
    assert only(dataset).what == "recomputed"
    after = Dataset.open(dataset)[ID]
    assert after.timing == {**about["timing"], "writer": {"dropped_images": 0}}
    assert (after.content_hash, after.success) == (about["content_hash"], about["success"])
    assert not check(dataset).findings


def test_wrong_flags_are_set_by_the_images(tmp_path: Path, moving: MakeMoving, monkeypatch: pytest.MonkeyPatch) -> None:
    def leave_out(rows: Rows) -> None:
        rows[4][RGB] = None
        rows[6]["flags/frames/wrist"] = 64

    monkeypatch.setattr("rcs_data.rows.FrameFlag", type("NoFlags", (), {"MISSING": 0}))  # a writer that says nothing
    path = moving(tmp_path, leave_out, length=12)
    assert [(f.kind, f.rows) for f in check(path).findings] == [("flags", (4, 6))]
    assert only(path).what == "recomputed"
    expected = np.zeros(12, np.uint8)
    expected[4] = FrameFlag.MISSING
    np.testing.assert_array_equal(Dataset.open(path).episodes[0].flags("wrist"), expected)


def test_damage_of_former_episodes_is_noted_and_then_known(dataset: Path) -> None:
    edit.delete(dataset, [ID])
    scribble(dataset / "episodes" / ID / "steps.parquet", 1000)
    (finding,) = check(dataset).damage
    assert (finding.kind, finding.episode, finding.file) == ("former", ID, f"episodes/{ID}/steps.parquet")
    assert only(dataset).what == "noted"
    assert not check(dataset).findings
    edit.undo(dataset)
    edit.undo(dataset)
    assert [finding.episode for finding in check(dataset).damage] == [ID], "an undo brings it back"


def test_a_kill_at_any_call_leaves_something_that_can_be_repaired(dataset: Path, tmp_path: Path) -> None:
    before = {e.id: e.content_hash for e in Dataset.open(dataset).episodes}
    edit.delete(dataset, ["000000"])
    data = bytearray(file(dataset).read_bytes())
    data[900] ^= 1
    file(dataset).write_bytes(bytes(data))
    scribble(dataset / "dataset.copy.json", 50)
    program = Path(__file__).parents[1] / "edit/kill_every_edit.py"
    subprocess.run([sys.executable, program, dataset, tmp_path, "repair", "5"], check=True, timeout=100)
    killed = [path for path in tmp_path.iterdir() if path.name.isdigit()]
    assert len(killed) > 8, "the kill must have hit more than a few calls"
    for path in killed:
        repair(path)
        assert check(path).is_ok, path.name
        assert {e.id: e.content_hash for e in Dataset.open(path).episodes} == {"000002": before["000002"]}


def test_a_dataset_that_somebody_writes_to_is_not_repaired(dataset: Path) -> None:
    scribble(file(dataset), 1000)
    lock = DatasetLock.writer(dataset)
    try:
        with pytest.raises(DatasetError, match="Another writer"):
            repair(dataset)
    finally:
        lock.release()
    assert not (dataset / "quarantine").exists()


def test_an_episode_of_a_newer_layout_is_no_damage_to_be_mended(dataset: Path) -> None:
    path = file(dataset, "episode.json")
    newer = sealed({**unsealed(path.read_bytes(), path), "schema_version": 99})
    path.write_bytes(newer)
    assert not repair(dataset).mendings
    assert path.read_bytes() == newer
