"""A repair makes everything else readable again, puts aside what is damaged as it was, and hides nothing."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from rcs_data import Dataset, DatasetWriter, check, edit
from rcs_data.check.repair import Mending, repair
from rcs_data.errors import CorruptEpisode, DatasetError
from rcs_data.files.durable import sealed, unsealed
from rcs_data.files.layout import new_trash
from rcs_data.files.lock import DatasetLock
from rcs_data.files.output import temporary_folder

if TYPE_CHECKING:
    from conftest import MakeInfo, MakeRows

STATE = 5
ID = "000001"
INDEX = "episodes.jsonl"


def file(dataset: Path, name: str = "steps.parquet") -> Path:
    return Dataset.open(dataset)[ID].path / name


def ids(dataset: Path) -> list[str]:
    return [episode.id for episode in Dataset.open(dataset)]


def only(dataset: Path) -> Mending:
    (mending,) = repair(dataset)
    return mending


def scribble(path: Path, start: int, size: int = 64) -> None:
    data = bytearray(path.read_bytes())
    data[start : start + size] = bytes(byte ^ 0x5A for byte in data[start : start + size])
    path.write_bytes(bytes(data))


def test_a_whole_dataset_is_left_alone(dataset: Path) -> None:
    before = {path: path.read_bytes() for path in dataset.rglob("*") if path.is_file()}
    assert repair(dataset) == []
    assert {path: path.read_bytes() for path in dataset.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("how", ["damaged", "gone"])
def test_the_description_is_made_anew_from_the_index(dataset: Path, how: str) -> None:
    edit.relabel(dataset, "push")
    path = dataset / "dataset.json"
    data = path.read_bytes()
    path.unlink() if how == "gone" else path.write_bytes(data[:-20])
    assert len(Dataset.open(dataset)) == 3
    assert only(dataset).what == "restored"
    assert path.read_bytes() == data
    assert not check(dataset).findings


def test_a_folder_that_is_named_like_an_address_is_a_folder(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dataset.rename(tmp_path / "run:1")
    monkeypatch.chdir(tmp_path)
    assert check("run:1").is_ok
    assert repair("run:1") == []


def test_the_index_is_made_anew_from_the_episodes(dataset: Path) -> None:
    before = {episode.id: episode.entry for episode in Dataset.open(dataset)}
    (dataset / INDEX).unlink()
    assert [(f.severity, f.file) for f in check(dataset).damage] == [("damage", INDEX)]
    with pytest.raises(DatasetError, match="missing"):
        Dataset.open(dataset)
    assert {mending.what for mending in repair(dataset)} == {"restored", "recovered"}
    assert {episode.id: episode.entry for episode in Dataset.open(dataset)} == before
    assert not check(dataset).findings


@pytest.mark.parametrize("line", [0, 1, 2])
def test_a_damaged_line_of_the_index_is_left_out_and_its_episode_added_anew(dataset: Path, line: int) -> None:
    before = {episode.id: episode.entry for episode in Dataset.open(dataset)}
    path = dataset / INDEX
    lines = path.read_bytes().split(b"\n")
    lines[line] = lines[line].replace(b"0", b"1", 1)
    path.write_bytes(b"\n".join(lines))
    with pytest.raises(CorruptEpisode, match=f"damaged in line {line + 1}: its checksum"):
        Dataset.open(dataset)
    assert not check(dataset).is_ok
    repair(dataset)
    assert {episode.id: episode.entry for episode in Dataset.open(dataset)} == before
    assert not check(dataset).findings


def test_half_a_line_at_the_end_was_never_written(dataset: Path, make_info: MakeInfo) -> None:
    path = dataset / INDEX
    whole = path.read_bytes()
    path.write_bytes(whole + whole.split(b"\n")[1][:50])
    assert ids(dataset) == ["000000", ID, "000002"]
    assert not check(dataset).findings
    edit.delete(dataset, [ID])
    assert ids(dataset) == ["000000", "000002"]


def test_an_index_and_a_description_that_are_lost_are_told(dataset: Path) -> None:
    for name in ("dataset.json", "history/dataset.json"):
        scribble(dataset / name, 100)
    scribble(dataset / INDEX, 100)
    assert {mending.what for mending in repair(dataset)} == {"failed"}
    assert len(check(dataset).damage) == 2


def test_what_a_killed_writer_left_is_recovered_and_removed(
    dataset: Path, make_info: MakeInfo, make_rows: MakeRows
) -> None:
    with DatasetWriter.open(dataset, make_info(images=True), resume=True) as writer:
        episode = writer.episode("late", seed=0)
        for row in make_rows(4, images=True):
            episode.add(row, np.zeros(STATE))
    new_trash(dataset, "gone").mkdir(parents=True)
    assert {f.kind for f in check(dataset).findings} == {"left_open", "left_over"}
    assert [(m.what, m.episode) for m in repair(dataset)] == [("recovered", "late")]
    assert Dataset.open(dataset)["late"].length == 4
    assert not list(dataset.rglob("*gone*"))
    assert {f.kind for f in check(dataset).findings} == {"no_verdict"}


def test_what_a_killed_merge_left_beside_a_dataset_is_named_and_removed(dataset: Path) -> None:
    program = f"""
        import os
        from pathlib import Path
        from rcs_data.files.output import temporary_folder
        context = temporary_folder(Path({str(dataset)!r}))
        context.__enter__().mkdir()
        os.kill(os.getpid(), 9)
    """
    assert temporary_folder
    subprocess.run([sys.executable, "-c", __import__("textwrap").dedent(program)], check=False)
    assert [f.kind for f in check(dataset).findings] == ["left_over"]
    assert only(dataset).what == "removed"
    assert sorted(path.name for path in dataset.parent.iterdir()) == [dataset.name]


def test_a_finished_episode_that_the_index_lacks_is_added(dataset: Path) -> None:
    shutil.copytree(dataset / "episodes", dataset.parent / "kept")
    edit.delete(dataset, [ID])
    edit.prune(dataset)
    shutil.copytree(dataset.parent / "kept/000000", dataset / "episodes/late")
    path = dataset / "episodes/late/episode.json"
    path.write_bytes(sealed({**unsealed(path.read_bytes(), path), "id": "late"}))
    assert [f.kind for f in check(dataset).findings] == ["unlisted"]
    assert (only(dataset).what, ids(dataset)) == ("recovered", ["000000", "000002", "late"])


def test_damaged_episodes_are_put_aside_as_they_were(dataset: Path) -> None:
    path = file(dataset)
    scribble(path, 1000)
    damaged = path.read_bytes()
    mending = only(dataset)
    assert (mending.what, mending.episode) == ("quarantined", ID)
    assert (dataset / "quarantine" / ID / "steps.parquet").read_bytes() == damaged
    assert ids(dataset) == ["000000", "000002"]
    assert check(dataset).is_ok
    assert [line.command for line in Dataset.open(dataset).history] == ["repair"]
    with pytest.raises(DatasetError, match="are in quarantine"):
        edit.undo(dataset)
    edit.prune(dataset)
    assert (dataset / "quarantine" / ID / "steps.parquet").read_bytes() == damaged


@pytest.mark.parametrize("how", ["gone", "cut"])
def test_an_episode_without_its_description_is_put_aside(dataset: Path, how: str) -> None:
    path = file(dataset, "episode.json")
    path.unlink() if how == "gone" else path.write_bytes(path.read_bytes()[:-9])
    assert only(dataset).what == "quarantined"
    assert ids(dataset) == ["000000", "000002"]
    assert (dataset / "quarantine" / ID / "steps.parquet").exists()


def test_an_episode_whose_folder_is_gone_is_no_longer_listed(dataset: Path) -> None:
    shutil.rmtree(dataset / "episodes" / ID)
    assert "its folder is gone" in only(dataset).message
    assert ids(dataset) == ["000000", "000002"]


@pytest.mark.parametrize("stride", [pytest.param(1, marks=pytest.mark.slow), 11])
def test_a_kill_at_any_call_leaves_something_that_can_be_repaired(dataset: Path, tmp_path: Path, stride: int) -> None:
    before = {e.id: e.content_hash for e in Dataset.open(dataset).episodes}
    edit.delete(dataset, ["000000"])
    scribble(file(dataset), 900)
    scribble(dataset / "dataset.json", 50)
    program = Path(__file__).parents[1] / "edit/kill_every_edit.py"
    subprocess.run([sys.executable, program, dataset, tmp_path, "repair", str(stride)], check=True, timeout=300)
    killed = [path for path in tmp_path.iterdir() if path.name.isdigit()]
    assert len(killed) > 8 // stride + 2, "the kill must have hit more than a few calls"
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
    assert not repair(dataset)
    assert path.read_bytes() == newer


def contents(dataset: Path) -> dict[str, tuple[str, int]]:
    return {episode.id: (episode.content_hash, episode.length) for episode in Dataset.open(dataset)}


@pytest.mark.parametrize("is_pruned", [True, False])
def test_edited_episodes_survive_the_loss_of_the_index(dataset: Path, is_pruned: bool) -> None:
    edit.resize(dataset, (12, 8))
    edit.trim(dataset, ID, first=1)
    if is_pruned:
        edit.prune(dataset)
    before, info = contents(dataset), Dataset.open(dataset).info
    (dataset / INDEX).unlink()
    mendings = repair(dataset)
    assert (contents(dataset), Dataset.open(dataset).info) == (before, info)
    assert not check(dataset).damage
    assert not any(mending.what == "removed" for mending in mendings)
    assert not repair(dataset)


def damage_line(dataset: Path) -> None:
    """Damage the line that the index has of an episode."""
    lines = (dataset / INDEX).read_bytes().split(b"\n")
    place = next(number for number, line in enumerate(lines) if ID.encode() in line)
    lines[place] = lines[place].replace(b'"length"', b'"lengtj"')
    (dataset / INDEX).write_bytes(b"\n".join(lines))


def test_a_damaged_line_costs_no_edited_episode(dataset: Path) -> None:
    edit.rename_camera(dataset, "wrist", "hand")
    edit.prune(dataset)
    before = contents(dataset)
    damage_line(dataset)
    assert any(mending.what == "recovered" and mending.episode == ID for mending in repair(dataset))
    assert contents(dataset) == before
    assert not check(dataset).damage


@pytest.mark.parametrize("episodes", [[ID], None])
@pytest.mark.parametrize("is_trimmed", [False, True])
def test_a_damaged_line_costs_no_label(dataset: Path, is_trimmed: bool, episodes: list[str] | None) -> None:
    edit.relabel(dataset, "pull", episodes=[ID])
    if is_trimmed:
        edit.trim(dataset, ID, first=1)
    edit.relabel(dataset, "push", episodes=episodes)
    edit.relabel(dataset, "lift", episodes=["000000"])
    before = {episode.id: episode.entry for episode in Dataset.open(dataset)}
    damage_line(dataset)
    repair(dataset)
    assert {episode.id: episode.entry for episode in Dataset.open(dataset)} == before
    assert Dataset.open(dataset)[ID].instruction == "push"


def test_a_label_that_was_taken_back_stays_so(dataset: Path) -> None:
    edit.relabel(dataset, "push", episodes=[ID])
    edit.undo(dataset)
    damage_line(dataset)
    repair(dataset)
    assert Dataset.open(dataset)[ID].instruction == "pick the cuboid"


def test_an_edit_after_the_loss_of_the_history_keeps_what_it_wrote(dataset: Path) -> None:
    edit.trim(dataset, ID, first=1)
    scribble(dataset / "history/1.jsonl", 20)
    assert only(dataset).what == "quarantined"
    edit.trim(dataset, ID, first=1)
    assert check(dataset).is_ok
    assert len(Dataset.open(dataset)[ID].column("observation/joints")) == 5


@pytest.mark.parametrize(("then", "instruction"), [("undo", "pick the cuboid"), ("repair", "push")])
def test_the_loss_of_an_undone_edit_costs_no_other(dataset: Path, then: str, instruction: str) -> None:
    edit.relabel(dataset, "push", episodes=[ID])
    edit.trim(dataset, "000000", first=1)
    edit.undo(dataset)
    scribble(dataset / "history/2.jsonl", 20)
    assert only(dataset).what == "quarantined"
    if then == "undo":
        edit.undo(dataset)
    else:  # the label of an episode whose line is damaged is that of the edits in force
        damage_line(dataset)
        repair(dataset)
    assert Dataset.open(dataset)[ID].instruction == instruction
