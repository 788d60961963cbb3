"""Names that become paths stay in their folder, and nothing is written through a link that leads out."""

from __future__ import annotations

import os
import shutil
import tarfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetWriter, check, edit, recover
from rcs_data.check.repair import repair
from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup
from rcs_data.files.durable import sealed, unsealed
from rcs_data.files.layout import check_name, is_name, name_of
from rcs_data.index.history import locked
from rcs_data.view import write_view

if TYPE_CHECKING:
    from conftest import MakeInfo, MakeRows, Record

BAD = ["", ".", "..", "../x", "a/b", "a\\b", ".hidden", "\n", "\udcff", "ä" * 101, None, 3]


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_name_is_refused(name: Any) -> None:
    with pytest.raises(InvalidSetup, match="cannot name a part"):
        check_name(name, "a part")


@pytest.mark.parametrize("name", ["a", "week 1", "größe", "a..b", "x" * 200])
def test_what_is_a_name_is_taken(name: str) -> None:
    check_name(name, "a part")


@pytest.mark.parametrize("folder", ["set", ".hidden", "a\udcff", "..." * 90, "\n"])
def test_every_folder_has_a_name_for_others(tmp_path: Path, folder: str) -> None:
    assert is_name(name_of(tmp_path / folder))


def lie(dataset: Path, source: dict[str, str]) -> None:
    for folder in (dataset / "episodes").iterdir():
        path = folder / "episode.json"
        about = unsealed(path.read_bytes(), path)
        path.write_bytes(sealed({**about, "source": {"digest": "", "source": None, **source}}))


@pytest.mark.parametrize("source", [{"dataset": "../../escaped", "episode": "a"}, {"dataset": "a", "episode": "../x"}])
def test_a_split_does_not_go_where_a_file_says(dataset: Path, tmp_path: Path, source: dict[str, str]) -> None:
    lie(dataset, source)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(CorruptEpisode, match="source is"):
        edit.split(dataset, tmp_path / "deep/out")
    assert sorted(tmp_path.rglob("*")) == before


def test_a_part_is_not_named_out_of_its_folder(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidSetup, match="cannot name a part"):
        edit.split(dataset, tmp_path / "out", parts={"../a": 0.5, "b": 0.5})
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["episodes", "former", "open", "history", "quarantine"])
def test_nothing_is_written_through_a_link_that_leads_out(dataset: Path, tmp_path: Path, name: str) -> None:
    outside = tmp_path / "outside"
    if (dataset / name).exists():
        shutil.move(dataset / name, outside)
    else:
        outside.mkdir()
    (dataset / name).symlink_to(outside)
    before = sorted(outside.rglob("*"))
    for change in (recover, repair, lambda path: edit.delete(path, ["000000"]), lambda path: edit.prune(path)):
        with pytest.raises(DatasetError, match=f"{name} to .*outside. Nothing is written through"):
            change(dataset)
    assert sorted(outside.rglob("*")) == before
    assert len(Dataset.open(dataset)) == 3, "it is read all the same"
    assert "link" in {finding.kind for finding in check(dataset).warnings}


def test_links_within_a_dataset_and_to_it_are_followed(dataset: Path, tmp_path: Path) -> None:
    (dataset / "episodes").rename(dataset / "real")
    (dataset / "episodes").symlink_to("real")
    (tmp_path / "link").symlink_to(dataset)
    edit.delete(tmp_path / "link", ["000000"])
    assert len(Dataset.open(dataset)) == 2


@pytest.mark.parametrize("name", [".writer.lock", "dataset.json.tmp", "view"])
def test_a_link_in_the_place_of_a_file_is_not_written_through(dataset: Path, tmp_path: Path, name: str) -> None:
    outside = tmp_path / "mine"
    outside.mkdir() if name == "view" else outside.write_text("mine")
    (dataset / name).unlink(missing_ok=True)
    (dataset / name).symlink_to(outside)
    for change in (recover, lambda path: edit.relabel(path, "push"), write_view):
        try:
            change(dataset)
        except DatasetError:
            continue
    assert not list(outside.iterdir()) if name == "view" else outside.read_text() == "mine"


@pytest.mark.parametrize("name", ["episodes.jsonl", "dataset.json"])
def test_a_dataset_whose_index_is_a_link_is_read_and_not_written(dataset: Path, tmp_path: Path, name: str) -> None:
    victim = tmp_path / "victim"
    shutil.copytree(dataset, victim)
    (dataset / name).unlink()
    (dataset / name).symlink_to(victim / name)
    before = (victim / name).read_bytes()
    info = Dataset.open(dataset).info
    for change in (
        recover, repair, edit.undo, edit.prune,
        lambda path: edit.delete(path, ["000001"]),
        lambda path: edit.relabel(path, "push"),
        lambda path: DatasetWriter.open(path, info, resume=True),
    ):  # fmt: skip
        with pytest.raises(DatasetError, match=f"{name} to .*victim.* Nothing is written through"):
            change(dataset)
    assert (victim / name).read_bytes() == before
    assert (dataset / name).is_symlink()
    assert len(Dataset.open(dataset)) == 3, "it is read all the same"
    assert [(finding.kind, finding.file) for finding in check(dataset).warnings] == [("link", name)]


def test_an_index_that_becomes_a_link_after_the_lock_is_taken_is_not_written(dataset: Path, tmp_path: Path) -> None:
    with locked(dataset) as journal:
        (dataset / "episodes.jsonl").rename(tmp_path / "victim")
        (dataset / "episodes.jsonl").symlink_to(tmp_path / "victim")
        before = (tmp_path / "victim").read_bytes()
        with pytest.raises(OSError, match="symbolic link"):
            journal.remove("000001")
    assert (tmp_path / "victim").read_bytes() == before


def test_a_copy_by_hard_links_stays_as_it_was(dataset: Path, tmp_path: Path) -> None:
    shutil.copytree(dataset, tmp_path / "snapshot", copy_function=os.link)
    digest = Dataset.open(dataset).digest()
    edit.delete(dataset, ["000001"])
    edit.trim(tmp_path / "snapshot", "000002", first=1)
    edit.undo(tmp_path / "snapshot")
    assert Dataset.open(tmp_path / "snapshot").digest() == digest
    assert [episode.id for episode in Dataset.open(dataset)] == ["000000", "000002"]
    assert check(dataset).is_ok
    assert check(tmp_path / "snapshot").is_ok


def test_a_dataset_that_is_being_recorded_goes_on_elsewhere(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows, record: Record
) -> None:
    path, moved = tmp_path / "here", tmp_path / "there/here"
    with DatasetWriter.open(path, make_info(images=True)) as writer:
        record(writer, "000000")
        with writer.episode("000001", seed=1) as episode:
            for row in make_rows(20, images=True):
                episode.add(row, np.zeros(writer.info.sim_state_size or 0))
            with tarfile.open(tmp_path / "set.tar", "w") as archive:
                archive.add(path, path.name)
    shutil.rmtree(path)
    with tarfile.open(tmp_path / "set.tar") as archive:
        archive.extractall(moved.parent, filter="data")
    with DatasetWriter.open(moved, make_info(images=True), resume=True) as writer:
        assert writer.recovered.recovered == ("000001",)
        record(writer, "000002", seed=2)
    digest = Dataset.open(moved).digest()
    edit.delete(moved, ["000000"])
    assert [episode.id for episode in Dataset.open(moved)] == ["000001", "000002"]
    edit.undo(moved)
    assert Dataset.open(moved).digest() == digest
    assert check(moved).is_ok


def test_a_merge_of_files_that_are_links_has_their_bytes(dataset: Path, tmp_path: Path) -> None:
    file = dataset / "episodes/000001/steps.parquet"
    file.rename(tmp_path / "blob")
    file.symlink_to("../../../blob")
    edit.merge([dataset], tmp_path / "far/away/merged")
    assert not any(path.is_symlink() for path in (tmp_path / "far").rglob("*"))
    assert check(tmp_path / "far/away/merged").is_ok


def test_an_open_episode_that_is_a_link_is_left_alone(dataset: Path, tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    shutil.copytree(dataset / "episodes/000000", outside)
    (dataset / "open/x").symlink_to(outside)
    assert "is not a folder but a link" in recover(dataset).failed[0][1]
    repair(dataset)
    assert len(list(outside.iterdir())) == 3
    assert check(dataset).is_ok
