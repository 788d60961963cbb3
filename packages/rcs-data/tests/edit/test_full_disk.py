"""A full disk stops an edit at any write or lets it be done; nothing is lost, and deleting and pruning free it."""

from __future__ import annotations

import errno
import itertools
import math
import mmap
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, check, edit, recover
from rcs_data.errors import DatasetError

if TYPE_CHECKING:
    from conftest import MakeDataset

EDITS: dict[str, Callable[[Path], object]] = {
    "delete": lambda path: edit.delete(path, ["000001"]),
    "keep": lambda path: edit.keep(path, ["000001"]),
    "trim": lambda path: edit.trim(path, "000001", first=1),
    "relabel": lambda path: edit.relabel(path, "push"),
    "rename_camera": lambda path: edit.rename_camera(path, "wrist", "hand"),
    "resize": lambda path: edit.resize(path, (12, 8)),
    "resample": lambda path: edit.resample(path, 10.0),
    "undo": edit.undo,
    "prune": edit.prune,
    "merge": lambda path: edit.merge([path, path], path.parent / "out"),
    "split": lambda path: edit.split(path, path.parent, parts={"out": 1.0}),
    "mix": lambda path: edit.mix([edit.Part(path=path)], path.parent / "out"),
}


def state(path: Path) -> tuple[str, DatasetInfo, list[str]]:
    """Return what a reader sees."""
    dataset = Dataset(path)
    return dataset.digest(), dataset.info, [episode.instruction for episode in dataset]


def attempt(name: str, path: Path, before: object) -> bool:
    """Return whether an edit was done; one that a full disk refuses has changed nothing."""
    try:
        EDITS[name](path)
    except DatasetError as err:
        error = str(err)
    else:
        return True
    assert "No space left" in error
    assert [*path.parent.iterdir()] == [path]
    assert state(path) == before
    return False


@pytest.mark.parametrize("name", EDITS)
def test_an_edit_that_a_full_disk_stops_at_any_write_has_changed_nothing(
    tmp_path: Path, make_dataset: MakeDataset, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    source = make_dataset(tmp_path / "source", [7, 3])
    edit.trim(source, "000000", first=1)
    before, seen = state(source), list[str]()
    for writes in itertools.count():
        disk = tmp_path / str(writes)
        path = shutil.copytree(source, disk / "set")
        with monkeypatch.context() as patch:
            refused = simulate(disk, patch, writes)
            attempt(name, path, before)
            seen.append(str(state(path)))
            edit.prune(path)
        assert str(state(path)) == seen[-1], "pruning, on the full disk, changes nothing"
        assert all(check(made).is_ok for made in disk.iterdir()), f"full after {writes} writes"
        if not refused:  # so the last one was done
            assert set(seen) <= {str(before), seen[-1]}
            return


@pytest.mark.slow
@pytest.mark.parametrize("name", EDITS)
def test_an_edit_on_a_disk_that_is_full_but_for_some_pages_is_done_or_has_changed_nothing(
    tmp_path: Path, make_dataset: MakeDataset, name: str
) -> None:
    source = make_dataset(tmp_path / "source", [7, 3])
    edit.trim(source, "000000", first=1)
    before = state(source)
    with mounted(tmp_path / "disk"):
        for pages in itertools.count():
            disk = tmp_path / "disk" / str(pages)
            path, filler = shutil.copytree(source, disk / "set"), tmp_path / "disk/filler"
            fill(filler, pages * mmap.PAGESIZE)
            is_done = attempt(name, path, before)
            edit.prune(path)
            assert all(check(made).is_ok for made in disk.iterdir()), f"{pages} pages were left"
            if is_done:
                return
            filler.unlink()
            shutil.rmtree(disk)


@pytest.fixture(params=["simulated", "mounted"])
def full_disk(
    tmp_path: Path, make_dataset: MakeDataset, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> Iterator[Path]:
    """A dataset on a disk without a free byte, with a former episode, and an open one that a recording has left."""
    disk = tmp_path / "disk"
    is_mounted = request.param == "mounted"
    with mounted(disk) if is_mounted else nullcontext():
        path = make_dataset(disk / "set", [60, 30, 20])
        edit.trim(path, "000000", first=1)
        leave_open(path)
        if is_mounted:
            fill(disk / "filler")
        else:
            simulate(disk, monkeypatch)
        yield path


@contextmanager
def mounted(disk: Path) -> Iterator[None]:
    """Mount a disk of 4 MiB at a new folder."""
    disk.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", disk], check=False).returncode:
        pytest.skip("this user cannot mount a small disk")
    try:
        yield
    finally:
        subprocess.run(["umount", disk], check=True)


def leave_open(path: Path) -> None:
    """Leave an episode of one row open, as a killed recording does."""
    info = Dataset(path).info
    row = {f.key: np.zeros(f.shape, f.dtype)[()] for f in info.features if not f.is_unknown_at_reset}
    with DatasetWriter.open(path, info, resume=True) as writer:
        writer.episode("open", seed=0).add(row, np.zeros(3))


def fill(path: Path, left: int = 0) -> None:
    """Write a file until the disk takes no more byte, and give some back."""
    fd = os.open(path, os.O_WRONLY | os.O_CREAT)
    size = 1 << 20
    while size:
        try:
            os.write(fd, bytes(size))
        except OSError:
            size //= 2
    os.ftruncate(fd, os.fstat(fd).st_size - left)
    os.close(fd)


def simulate(disk: Path, monkeypatch: pytest.MonkeyPatch, left: int = 0) -> list[str]:
    """Let no file in a folder grow, and no folder be made, unless others have shrunk; return what is refused, as it is.

    Args:
        disk: The folder.
        monkeypatch: Undoes it.
        left: Writes and new folders until then.
    """
    write, mkdir = os.write, os.mkdir
    refused: list[str] = []

    def used() -> int:
        found = [path.lstat() for path in disk.rglob("*") if path.is_file()]
        return sum({one.st_ino: one.st_size for one in found}.values())

    def take(size: int, what: str) -> None:
        nonlocal left, capacity
        if size > 0 and left > 0:
            left -= 1
            capacity = math.inf if left else used() + size
        elif size > 0 and used() + size > capacity:
            refused.append(what)
            raise OSError(errno.ENOSPC, "No space left on device")

    def write_if_there_is_space(fd: int, data: bytes | memoryview) -> int:
        take(os.lseek(fd, 0, os.SEEK_CUR) + len(data) - os.fstat(fd).st_size, "write")
        return write(fd, data)

    def mkdir_if_there_is_space(*args: Any, **kwargs: Any) -> None:
        take(1, "mkdir")
        mkdir(*args, **kwargs)

    capacity: float = math.inf if left else used()
    monkeypatch.setattr("os.write", write_if_there_is_space)
    monkeypatch.setattr("os.mkdir", mkdir_if_there_is_space)
    return refused


def test_a_full_disk_is_freed_by_deleting_and_pruning(full_disk: Path) -> None:
    before = Dataset.open(full_disk)["000002"].content_hash
    with pytest.raises(DatasetError, match="No space left"):
        recover(full_disk)
    assert not (full_disk / "open/open/steps.parquet").exists(), "half a file would take what is left"
    edit.delete(full_disk, ["000001"])
    assert edit.prune(full_disk) > 1 << 16
    assert recover(full_disk).recovered == ("open",)
    assert check(full_disk).is_ok
    assert [episode.id for episode in Dataset.open(full_disk)] == ["000000", "000002", "open"]
    assert Dataset.open(full_disk)["000002"].content_hash == before


def test_the_reserve_for_a_full_disk_grows_with_the_dataset(
    tmp_path: Path, make_dataset: MakeDataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = make_dataset(tmp_path / "disk/set", [2] * 200)
    simulate(tmp_path / "disk", monkeypatch)
    edit.delete(path, ["000001"])
    assert edit.prune(path) > 0
    assert len(Dataset.open(path)) == 199


def test_on_a_full_disk_former_episodes_can_be_pruned_at_once(full_disk: Path) -> None:
    assert edit.prune(full_disk) > 1 << 14
    assert not any(finding.kind == "left_over" for finding in check(full_disk).findings)
    assert [episode.length for episode in Dataset.open(full_disk)] == [59, 30, 20]


def test_on_a_full_disk_an_open_episode_can_be_discarded(full_disk: Path) -> None:
    with DatasetWriter.open(full_disk, Dataset.open(full_disk).info, resume=True, leftovers="discard") as writer:
        assert writer.recovered.removed == ("open",)
    assert check(full_disk).is_ok
    assert not list((full_disk / "open").iterdir())
