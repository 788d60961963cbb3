"""An episode that was recorded into another dataset is taken in byte for byte, or not at all."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from rcs_data import Dataset, DatasetWriter, check
from rcs_data.errors import CorruptEpisode, DatasetError, InvalidSetup
from rcs_data.record.writer import Files

if TYPE_CHECKING:
    from conftest import MakeInfo, Record

CALLS = ("write", "fsync", "rename", "replace", "mkdir", "open")


def files_of(path: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in path.iterdir()}


@pytest.fixture
def files(tmp_path: Path, make_info: MakeInfo, record: Record) -> Files:
    with DatasetWriter.open(tmp_path / "away", make_info(images=True)) as writer:
        return files_of(record(writer, "a").path)


def test_an_adopted_episode_has_the_bytes_of_the_recorded_one(
    tmp_path: Path, make_info: MakeInfo, files: Files
) -> None:
    with DatasetWriter.open(tmp_path / "home", make_info(images=True)) as writer:
        writer.adopt("a", {name: memoryview(data) for name, data in files.items()})
    assert files_of(Dataset.open(tmp_path / "home")["a"].path) == files
    assert check(tmp_path / "home").is_ok


@pytest.mark.parametrize("name", ["steps.parquet", "frames.zip", "episode.json"])
def test_an_episode_that_changed_on_the_way_is_refused(
    tmp_path: Path, make_info: MakeInfo, files: Files, name: str
) -> None:
    data = bytearray(files[name])
    data[len(data) // 2] ^= 1
    with DatasetWriter.open(tmp_path / "home", make_info(images=True)) as writer:
        with pytest.raises(CorruptEpisode):
            writer.adopt("a", {**files, name: bytes(data)})
        writer.adopt("a", files)
    assert check(tmp_path / "home").is_ok


def test_files_that_are_missing_or_too_many_are_refused(tmp_path: Path, make_info: MakeInfo, files: Files) -> None:
    with DatasetWriter.open(tmp_path / "home", make_info(images=True)) as writer:
        with pytest.raises(CorruptEpisode, match=r"an episode of this dataset has .*frames\.zip"):
            writer.adopt("a", {name: data for name, data in files.items() if name != "frames.zip"})
        with pytest.raises(CorruptEpisode, match=r"\.\./more"):
            writer.adopt("a", {**files, "../more": b""})
        with pytest.raises(CorruptEpisode, match="an id or a hash"):
            writer.adopt("b", files)
        with pytest.raises(InvalidSetup, match="cannot name an episode"):
            writer.adopt("../a", files)
    assert len(Dataset.open(tmp_path / "home")) == 0


def test_an_episode_is_not_replaced_by_another_of_its_name(tmp_path: Path, make_info: MakeInfo, files: Files) -> None:
    with DatasetWriter.open(tmp_path / "home", make_info(images=True)) as writer:
        writer.adopt("a", files)
        with pytest.raises(DatasetError, match="already is an episode 'a'"):
            writer.adopt("a", files)
    with pytest.raises(DatasetError, match="closed"):
        writer.adopt("a", files)


def test_what_a_dead_worker_left_of_the_episode_is_replaced(tmp_path: Path, make_info: MakeInfo, files: Files) -> None:
    with DatasetWriter.open(tmp_path / "home", make_info(images=True)) as writer:
        left = tmp_path / "home" / "open" / "a"
        left.mkdir(parents=True)
        (left / "rows.arrows").write_bytes(b"half")
        writer.adopt("a", files)
    assert files_of(Dataset.open(tmp_path / "home")["a"].path) == files


def test_a_disk_that_fails_at_any_call_leaves_a_dataset_that_can_be_resumed(
    tmp_path: Path, make_info: MakeInfo, files: Files, monkeypatch: pytest.MonkeyPatch
) -> None:
    is_done, n = False, 0
    while not is_done:
        home, left = tmp_path / str(n), n

        def failing(call: Any) -> Any:
            def called(*args: Any, **kwargs: Any) -> Any:
                nonlocal left
                left -= 1
                if left < 0:
                    raise OSError(errno.EIO, "it is broken")
                return call(*args, **kwargs)

            return called

        with DatasetWriter.open(home, make_info(images=True)) as writer, monkeypatch.context() as patch:
            for name in CALLS:
                patch.setattr(os, name, failing(getattr(os, name)))
            try:
                writer.adopt("a", files)
                is_done = True
            except DatasetError:
                pass
        with DatasetWriter.open(home, make_info(images=True), resume=True, leftovers="discard") as writer:
            if not len(Dataset.open(home)):
                writer.adopt("a", files)
        assert files_of(Dataset.open(home)["a"].path) == files
        assert check(home).is_ok
        n += 1
    assert n > 8
