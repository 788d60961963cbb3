"""An edit is there or it is not, whenever it is killed; and it can be taken back."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, check, edit, recover
from rcs_data.errors import DatasetError, InvalidSetup
from rcs_data.lock import DatasetLock

if TYPE_CHECKING:
    from conftest import MakeDataset

HERE = Path(__file__).parent


def state(path: Path) -> tuple[str, DatasetInfo, tuple[str, ...]]:
    """What a reader sees."""
    dataset = Dataset.open(path)
    return dataset.digest(), dataset.info, tuple(episode.instruction for episode in dataset.episodes)


@pytest.mark.parametrize("name", ["delete", "trim", "relabel", "undo"])
def test_a_kill_before_any_call_leaves_the_dataset_before_or_after_the_edit(
    tmp_path: Path, make_dataset: MakeDataset, name: str
) -> None:
    source = make_dataset(tmp_path / "set", [7, 3])
    if name == "undo":
        edit.delete(source, ["000000"])
    before = state(source)
    subprocess.run([sys.executable, HERE / "kill_every_edit.py", source, tmp_path, name], check=True, timeout=100)
    killed = sorted((path for path in tmp_path.iterdir() if path.name.isdigit()), key=lambda path: int(path.name))
    after = state(killed[-1])
    assert before != after
    assert len(killed) > (8 if name == "undo" else 15), "the kill must have hit more than a few calls"
    seen = [state(path) for path in killed]
    assert set(map(str, seen)) == {str(before), str(after)}
    assert seen == sorted(seen, key=lambda found: found == after), "once it is done, it stays done"
    for path in killed:
        recover(path)
        report = check(path)
        assert report.is_ok, str(report)
        if state(path) == before:  # what is left of the killed one is not in the way
            {"delete": lambda p: edit.delete(p, ["000001"]), "undo": edit.undo}.get(name, lambda _: None)(path)


def test_a_killed_merge_leaves_nothing_or_all_of_the_new_dataset(tmp_path: Path, make_dataset: MakeDataset) -> None:
    source = make_dataset(tmp_path / "set", [4, 3])
    subprocess.run([sys.executable, HERE / "kill_every_edit.py", source, tmp_path, "merge"], check=True, timeout=100)
    merged = [path for path in tmp_path.iterdir() if path.name.endswith("-merged")]
    assert 1 <= len(merged) <= 6  # of kills after it was put in place
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
    commands = [line.command for line in Dataset.open(dataset).head.history]
    assert commands == ["delete", "relabel", "rename-camera", "undo", "undo", "undo"]


def test_after_an_undo_another_edit_can_be_made_and_undone(dataset: Path) -> None:
    before = state(dataset)
    edit.delete(dataset, ["000001"])
    edit.undo(dataset)
    edit.delete(dataset, ["000002"])
    assert [e.id for e in Dataset.open(dataset).episodes] == ["000000", "000001", "000003"]
    edit.undo(dataset)
    assert state(dataset) == before


def test_what_was_recorded_since_an_edit_is_not_lost_by_an_undo(dataset: Path) -> None:
    edit.delete(dataset, ["000001"])
    info = Dataset.open(dataset).info
    with DatasetWriter.open(dataset, info, resume=True) as writer:
        last = Dataset.open(dataset).episodes[0]
        with writer.episode("new", seed=1) as episode:
            row = {f.key: None if f.can_be_held and f.is_image else last.column(f.key)[0] for f in info.features}
            given = {key: value for key, value in row.items() if not key.startswith(("action", "executed", "reward"))}
            episode.add({**given, "time/period": None}, last.sim_state()[0])
            episode.finish(True)
    with pytest.raises(DatasetError, match=r"new were recorded .* undo would lose"):
        edit.undo(dataset)
    edit.delete(dataset, ["new"])
    edit.undo(dataset)
    assert "new" in [e.id for e in Dataset.open(dataset).episodes]


def test_unchanged_episodes_take_no_space_and_pruning_frees_what_changed(dataset: Path) -> None:
    def size() -> int:
        return sum({p.stat().st_ino: p.stat().st_size for p in dataset.rglob("*.parquet")}.values())

    before = size()
    edit.delete(dataset, ["000001"])
    assert size() == before
    deleted = sum(p.stat().st_size for p in (dataset / "episodes/000001").iterdir())
    assert edit.prune(dataset) == deleted
    assert check(dataset).is_ok
    assert [e.id for e in Dataset.open(dataset).episodes] == ["000000", "000002", "000003"]
    with pytest.raises(DatasetError, match="pruned"):
        edit.undo(dataset)


def test_an_edit_that_fails_leaves_the_dataset_as_it_was(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = state(dataset)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    for call in ("link", "fsync", "write"):
        with monkeypatch.context() as patch:
            patch.setattr(f"os.{call}", full)
            with pytest.raises(DatasetError, match="No space left"):
                edit.delete(dataset, ["000001"])
        assert state(dataset) == before
    with pytest.raises(InvalidSetup, match="no episode nothing"):
        edit.delete(dataset, ["nothing"])
    assert state(dataset) == before
    assert check(dataset).is_ok


def test_where_links_are_not_possible_files_are_copied(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(1, "Operation not permitted")

    monkeypatch.setattr("os.link", refuse)
    edit.delete(dataset, ["000001"])
    assert check(dataset).is_ok
    assert len(Dataset.open(dataset)) == 3


def test_a_dataset_that_is_being_recorded_is_not_edited(dataset: Path) -> None:
    lock = DatasetLock.writer(dataset)
    try:
        with pytest.raises(DatasetError, match="Another writer"):
            edit.delete(dataset, ["000001"])
    finally:
        lock.release()


def test_an_open_episode_must_be_recovered_first(dataset: Path) -> None:
    shutil.copytree(dataset / "episodes/000000", dataset / "episodes/.open-lost")
    with pytest.raises(DatasetError, match="run recover first"):
        edit.delete(dataset, ["000001"])


def test_a_reader_of_the_former_generation_can_go_on(dataset: Path) -> None:
    opened = Dataset.open(dataset)
    edit.delete(dataset, ["000001"])
    assert len(opened["000001"].column("observation/joints")) == 8


def test_a_flipped_bit_in_dataset_json_is_survived_by_its_copy(dataset: Path, caplog: pytest.LogCaptureFixture) -> None:
    edit.delete(dataset, ["000001"])
    before = state(dataset)
    path = dataset / "dataset.json"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(bytes(data))
    assert state(dataset) == before
    assert "dataset.copy.json" in caplog.text
    assert [finding.file for finding in check(dataset).damage] == ["dataset.json"]
