"""An edit is there or it is not, whenever it is killed; and it can be taken back."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rcs_data import Dataset, DatasetInfo, DatasetWriter, EpisodeRecord, check, edit, recover
from rcs_data.errors import DatasetError, InvalidSetup
from rcs_data.files.lock import DatasetLock

if TYPE_CHECKING:
    from conftest import MakeDataset

HERE = Path(__file__).parent


def state(path: Path) -> tuple[str, DatasetInfo, tuple[str, ...]]:
    """Return what a reader sees."""
    dataset = Dataset.open(path)
    return dataset.digest(), dataset.info, tuple(episode.instruction for episode in dataset.episodes)


def kill_every_edit(source: Path, folder: Path, name: str, stride: int = 1) -> None:
    """Edit copies of a dataset, each killed before another call."""
    program = [sys.executable, HERE / "kill_every_edit.py", source, folder, name, str(stride)]
    subprocess.run(program, check=True, timeout=300)


EVERY_CALL = pytest.param(1, marks=pytest.mark.slow)
"""Kills before every call take half a minute; the default tests do some."""


@pytest.mark.parametrize("stride", [EVERY_CALL, 7])
@pytest.mark.parametrize("name", ["delete", "trim", "relabel", "undo"])
def test_a_kill_before_any_call_leaves_the_dataset_before_or_after_the_edit(
    tmp_path: Path, make_dataset: MakeDataset, name: str, stride: int
) -> None:
    source = make_dataset(tmp_path / "set", [7, 3])
    if name == "undo":
        edit.delete(source, ["000000"])
    before = state(source)
    kill_every_edit(source, tmp_path, name, stride)
    killed = sorted((path for path in tmp_path.iterdir() if path.name.isdigit()), key=lambda path: int(path.name))
    after = state(killed[-1])
    assert before != after
    assert len(killed) > 3, "the kill must have hit more than a few calls"
    seen = [state(path) for path in killed]
    assert set(map(str, seen)) == {str(before), str(after)}
    assert seen == sorted(seen, key=lambda found: found == after), "once it is done, it stays done"
    for path in killed:
        recover(path)
        report = check(path)
        assert report.is_ok, str(report)
        if state(path) == before:  # what is left of the killed one is not in the way
            {"delete": lambda p: edit.delete(p, ["000001"]), "undo": edit.undo}.get(name, lambda _: None)(path)


@pytest.mark.parametrize("stride", [EVERY_CALL, 11])
def test_a_killed_merge_leaves_nothing_or_all_of_the_new_dataset(
    tmp_path: Path, make_dataset: MakeDataset, stride: int
) -> None:
    source = make_dataset(tmp_path / "set", [4, 3])
    kill_every_edit(source, tmp_path, "merge", stride)
    merged = [path for path in tmp_path.iterdir() if path.name.endswith("-merged")]
    assert 1 <= len(merged) <= 12  # of kills after it was put in place
    for path in merged:
        assert check(path).is_ok
        assert len(Dataset.open(path)) == 4


def test_undo_takes_back_one_edit_after_the_other(dataset: Path) -> None:
    states = [state(dataset)]
    edit.delete(dataset, ["000001"])
    states.append(state(dataset))
    edit.relabel(dataset, "push")
    states.append(state(dataset))
    edit.rename_camera(dataset, "wrist", "hand")
    for expected in reversed(states):
        edit.undo(dataset)
        assert state(dataset) == expected
    with pytest.raises(DatasetError, match="nothing to undo"):
        edit.undo(dataset)
    commands = [line.command for line in Dataset.open(dataset).history]
    assert commands == ["delete", "relabel", "rename-camera", "undo", "undo", "undo"]


def test_after_an_undo_another_edit_can_be_made_and_undone(dataset: Path) -> None:
    before = state(dataset)
    edit.delete(dataset, ["000001"])
    edit.undo(dataset)
    edit.delete(dataset, ["000002"])
    assert [e.id for e in Dataset.open(dataset).episodes] == ["000000", "000001", "000003"]
    edit.undo(dataset)
    assert state(dataset) == before


def first_row(episode: EpisodeRecord) -> tuple[dict[str, Any], NDArray[np.float64]]:
    """Return an episode's first row and state, as they are recorded."""
    features = episode.info.features
    row = {f.key: None if f.is_image else episode.column(f.key)[0] for f in features}
    given = {key: value for key, value in row.items() if not key.startswith(("action", "executed", "reward"))}
    return {**given, "time/period": None}, episode.sim_state()[0]


def record(writer: DatasetWriter, name: str, like: EpisodeRecord) -> None:
    """Record an episode of one row, that of another one's start."""
    with writer.episode(name, seed=1) as episode:
        episode.add(*first_row(like))
        episode.finish(True)


def leave_open(path: Path, name: str) -> None:
    """Leave an episode of one row open, as a killed recording does."""
    dataset = Dataset.open(path)
    with DatasetWriter.open(path, dataset.info, resume=True) as writer:
        writer.episode(name, seed=0).add(*first_row(dataset.episodes[0]))


def test_what_was_recorded_since_an_edit_is_not_lost_by_an_undo(dataset: Path) -> None:
    edit.delete(dataset, ["000001"])
    info = Dataset.open(dataset).info
    with DatasetWriter.open(dataset, info, resume=True) as writer:
        last = Dataset.open(dataset).episodes[0]
        record(writer, "new", last)
    with pytest.raises(DatasetError, match=r"Episodes were added to .* since 'delete'"):
        edit.undo(dataset)
    assert [e.id for e in Dataset.open(dataset).episodes] == ["000000", "000002", "000003", "new"]


def test_the_id_of_a_deleted_episode_is_free_and_neither_episode_is_lost(dataset: Path) -> None:
    before = Dataset.open(dataset)["000001"].content_hash
    edit.delete(dataset, ["000001"])
    with DatasetWriter.open(dataset, Dataset.open(dataset).info, resume=True) as writer:
        record(writer, "000001", Dataset.open(dataset).episodes[0])
    assert Dataset.open(dataset)["000001"].length == 1
    assert check(dataset).is_ok
    edit.delete(dataset, ["000001"])
    edit.undo(dataset)
    with pytest.raises(DatasetError, match=r"Episodes were added to .* since 'delete'"):
        edit.undo(dataset)
    assert Dataset.open(dataset)["000001"].length == 1
    with DatasetWriter.open(dataset, Dataset.open(dataset).info, resume=True) as writer:
        writer.remove_episode("000001")
    edit.undo(dataset)
    assert Dataset.open(dataset)["000001"].content_hash == before
    assert check(dataset).is_ok


@pytest.mark.parametrize("later", ["delete", "relabel"])
def test_what_was_recorded_is_remembered_through_later_edits(dataset: Path, later: str) -> None:
    edit.rename_camera(dataset, "wrist", "hand")
    with DatasetWriter.open(dataset, Dataset.open(dataset).info, resume=True) as writer:
        record(writer, "new", Dataset.open(dataset).episodes[0])
    edit.delete(dataset, ["000001"]) if later == "delete" else edit.relabel(dataset, "push", episodes=["000001"])
    edit.undo(dataset)
    with pytest.raises(DatasetError, match="Episodes were added to"):
        edit.undo(dataset)
    assert check(dataset).is_ok


def test_undo_leaves_nothing_behind(dataset: Path) -> None:
    before = sorted((dataset / "episodes").rglob("*"))
    edit.trim(dataset, "000001", first=1)
    edit.undo(dataset)
    assert sorted((dataset / "episodes").rglob("*")) == before
    assert not any(finding.kind in ("left_over", "unlisted") for finding in check(dataset).findings)


def test_ids_that_look_like_folders_of_edits_are_refused(dataset: Path) -> None:
    info = Dataset.open(dataset).info
    with DatasetWriter.open(dataset, info, resume=True) as writer:
        for name in ("000001@1", "a+2", "@@3"):
            with pytest.raises(InvalidSetup, match="must not end in '@' or '\\+' and a number"):
                writer.episode(name, seed=0)
        record(writer, "take@one", Dataset.open(dataset).episodes[0])


def test_former_episodes_of_the_longest_ids_are_no_garbage(dataset: Path) -> None:
    name, before = "x" * 200, state(dataset)
    with DatasetWriter.open(dataset, Dataset.open(dataset).info, resume=True) as writer:
        with pytest.raises(InvalidSetup, match="1 to 200 bytes"):
            writer.episode(name + "x", seed=0)
        record(writer, name, Dataset.open(dataset).episodes[0])
    recorded = state(dataset)
    for _ in range(11):
        edit.trim(dataset, name)
    assert {finding.kind for finding in check(dataset).findings}.isdisjoint({"stranger", "left_over", "missing"})
    recover(dataset)
    for _ in range(11):
        edit.undo(dataset)
    assert state(dataset) == recorded != before
    edit.delete(dataset, [name])
    with DatasetWriter.open(dataset, Dataset.open(dataset).info, resume=True) as writer:
        record(writer, name, Dataset.open(dataset).episodes[0])
    assert check(dataset).is_ok
    assert edit.prune(dataset) > 0
    assert len(Dataset.open(dataset)) == 5


def test_digits_of_other_scripts_are_no_number_of_an_edit(dataset: Path) -> None:
    with DatasetWriter.open(dataset, Dataset.open(dataset).info, resume=True) as writer:
        record(writer, "a@\N{ARABIC-INDIC DIGIT THREE}", Dataset.open(dataset).episodes[0])
    edit.trim(dataset, "000000", first=1)
    assert [line.number for line in Dataset.open(dataset).history] == [1]


def test_undo_waits_for_what_a_killed_recording_left_open(dataset: Path) -> None:
    edit.delete(dataset, ["000001"])
    leave_open(dataset, "000001")
    with pytest.raises(DatasetError, match="run recover first"):
        edit.undo(dataset)
    recover(dataset)
    with pytest.raises(DatasetError, match="Episodes were added to"):
        edit.undo(dataset)


def test_thirty_edits_leave_the_index_as_short_as_it_was(dataset: Path) -> None:
    for number in range(30):
        edit.relabel(dataset, f"pick {number}", episodes=["000001"])
    assert len((dataset / "episodes.jsonl").read_bytes().splitlines()) == 4
    assert [e.instruction for e in Dataset.open(dataset)][1] == "pick 29"
    assert [line.number for line in Dataset.open(dataset).history] == [*range(1, 31)]
    assert len(list((dataset / "episodes").iterdir())) == 4


def test_unchanged_episodes_take_no_space_and_pruning_frees_what_changed(dataset: Path) -> None:
    def size() -> int:
        return sum({p.stat().st_ino: p.stat().st_size for p in dataset.rglob("*.parquet")}.values())

    before = size()
    edit.delete(dataset, ["000001"])
    assert size() == before
    deleted = sum(p.stat().st_size for p in (dataset / "former/000001").iterdir())
    assert edit.prune(dataset) == deleted
    assert check(dataset).is_ok
    assert [e.id for e in Dataset.open(dataset).episodes] == ["000000", "000002", "000003"]
    with pytest.raises(DatasetError, match="were pruned"):
        edit.undo(dataset)


def test_an_edit_that_fails_leaves_the_dataset_as_it_was(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = state(dataset)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    for call in ("fsync", "write"):
        with monkeypatch.context() as patch:
            patch.setattr(f"os.{call}", full)
            with pytest.raises(DatasetError, match="No space left"):
                edit.delete(dataset, ["000001"])
        assert state(dataset) == before
    with pytest.raises(InvalidSetup, match="no episode nothing"):
        edit.delete(dataset, ["nothing"])
    assert state(dataset) == before
    assert check(dataset).is_ok


def test_an_edit_that_is_decided_is_not_to_be_repeated(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rename = os.rename

    def refuse(source: Any, target: Any) -> None:
        if "/former/" in str(target):
            raise OSError(13, "Permission denied")
        rename(source, target)

    with monkeypatch.context() as patch:
        patch.setattr("os.rename", refuse)
        with pytest.raises(DatasetError, match=r"'trim' is done, .*: Permission denied\..* do not repeat it"):
            edit.trim(dataset, "000000", first=2)
    assert Dataset.open(dataset)["000000"].length == 11
    recover(dataset)
    assert Dataset.open(dataset)["000000"].length == 11
    assert check(dataset).is_ok
    assert not (dataset / ".edit").exists()


def test_a_killed_prune_can_be_done_again(tmp_path: Path, make_dataset: MakeDataset) -> None:
    source = make_dataset(tmp_path / "set", [7, 3])
    edit.trim(source, "000000", first=1)
    edit.delete(source, ["000001"])
    before = state(source)
    kill_every_edit(source, tmp_path, "prune")
    killed = [path for path in tmp_path.iterdir() if path.name.isdigit()]
    assert len(killed) > 5, "the kill must have hit more than a few calls"
    for path in killed:
        assert state(path) == before
        report = check(path)
        assert report.is_ok, str(report)
        edit.prune(path)
        assert not any(finding.kind == "left_over" for finding in check(path).findings)
        assert [folder.name for folder in (path / "episodes").iterdir()] == ["000000@1"]


def test_where_links_are_not_possible_files_are_copied(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(1, "Operation not permitted")

    monkeypatch.setattr("os.link", refuse)
    edit.merge([dataset], tmp_path / "merged")
    assert check(tmp_path / "merged").is_ok
    assert len(Dataset.open(tmp_path / "merged")) == 4


def test_a_dataset_that_is_being_recorded_is_not_edited(dataset: Path) -> None:
    lock = DatasetLock.writer(dataset)
    try:
        with pytest.raises(DatasetError, match="Another writer"):
            edit.delete(dataset, ["000001"])
    finally:
        lock.release()


def test_an_open_episode_must_be_recovered_before_others_get_another_form(dataset: Path) -> None:
    leave_open(dataset, "lost")
    with pytest.raises(DatasetError, match="run recover first"):
        edit.rename_camera(dataset, "wrist", "hand")
    with pytest.raises(DatasetError, match="run recover first"):
        edit.relabel(dataset, "push")
    edit.delete(dataset, ["000001"])
    assert recover(dataset).recovered == ("lost",)
    assert check(dataset).is_ok


@pytest.mark.parametrize("change", ["resize", "undo"])
def test_a_finished_episode_that_the_index_lacks_must_be_recovered_first(dataset: Path, change: str) -> None:
    edit.resize(dataset, (12, 8))
    with DatasetWriter.open(dataset, Dataset.open(dataset).info, resume=True) as writer:
        record(writer, "late", Dataset.open(dataset).episodes[0])
    index = dataset / "episodes.jsonl"
    index.write_bytes(b"".join(index.read_bytes().splitlines(keepends=True)[:-1]))  # as a full disk leaves it
    with pytest.raises(DatasetError, match=r"late of .* run recover first"):
        edit.undo(dataset) if change == "undo" else edit.resize(dataset, (6, 4))
    assert recover(dataset).published == ("late",)
    assert check(dataset).is_ok


def test_an_edit_can_be_undone_in_a_copy_without_empty_folders(dataset: Path) -> None:
    before = state(dataset)
    edit.relabel(dataset, "push", episodes=["000001"])
    for name in ("former", "open"):
        (dataset / name).rmdir()
    edit.undo(dataset)
    assert state(dataset) == before


def test_a_reader_that_opened_the_dataset_before_can_go_on(dataset: Path) -> None:
    opened = Dataset.open(dataset)
    edit.delete(dataset, ["000001"])
    assert len(opened["000001"].column("observation/joints")) == 8


def test_a_flipped_bit_in_dataset_json_changes_nothing_and_is_found(dataset: Path) -> None:
    edit.delete(dataset, ["000001"])
    before = state(dataset)
    path = dataset / "dataset.json"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(bytes(data))
    assert state(dataset) == before
    assert [finding.file for finding in check(dataset).damage] == ["dataset.json"]


def test_a_file_beside_the_episodes_is_in_the_way_of_no_edit(dataset: Path) -> None:
    edit.delete(dataset, ["000001"])
    (dataset / "episodes" / "notes.txt").touch()
    edit.undo(dataset)
    assert Dataset.open(dataset)["000001"].length > 0
