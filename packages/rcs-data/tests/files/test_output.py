"""Leftovers of a killed call beside its result are named and removed by the next one, and what lives stays."""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from rcs_data import Dataset, edit
from rcs_data.convert.lerobot.export import export_lerobot
from rcs_data.convert.lerobot.import_ import import_lerobot
from rcs_data.errors import DatasetError
from rcs_data.files import durable
from rcs_data.files.durable import disk_errors
from rcs_data.files.output import new_output, remove_leftovers, require_writable

DYING = """
import os, sys, signal
from pathlib import Path
from rcs_data.files.output import new_output
with new_output(sys.argv[1]) as partial:
    if sys.argv[2] == "folder":
        (partial / "deep").mkdir(parents=True)
        (partial / "deep" / "file").write_text("half")
    else:
        partial.write_text("half")
    print("at work", flush=True)
    if sys.argv[3] == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    sys.stdin.readline()
"""


def start(out: Path, kind: str, how: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", DYING, str(out), kind, how]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "at work\n"
    return process


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_what_a_kill_leaves_is_removed_and_named_by_the_next_call(
    tmp_path: Path, kind: str, caplog: pytest.LogCaptureFixture
) -> None:
    out = tmp_path / "result"
    for _ in range(2):
        with start(out, kind, "dies") as process:
            assert process.wait(20) == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 2, "the second call has removed what the first had left"
    with caplog.at_level(logging.WARNING), new_output(out) as partial:
        partial.write_text("whole")
    assert [path.name for path in tmp_path.iterdir()] == ["result"]
    assert "left by a killed call" in caplog.text


def test_what_another_process_is_at_stays(tmp_path: Path) -> None:
    out = tmp_path / "result"
    with start(out, "folder", "lives") as process:
        assert remove_leftovers(out) == []
        assert process.stdin is not None
        process.stdin.write("go on\n")
        process.stdin.flush()
        assert process.wait(20) == 0
    assert (out / "deep" / "file").read_text() == "half"
    assert [path.name for path in tmp_path.iterdir()] == ["result"]


def test_results_of_other_names_stay(tmp_path: Path) -> None:
    with start(tmp_path / "other", "folder", "dies") as process:
        process.wait(20)
    with new_output(tmp_path / "result") as partial:
        partial.mkdir()
    assert len(list(tmp_path.iterdir())) == 3
    assert remove_leftovers(tmp_path / "other")


def test_an_error_leaves_nothing(tmp_path: Path) -> None:
    def fail() -> None:
        with new_output(tmp_path / "result") as partial:
            partial.mkdir()
            raise ValueError("mine")

    with pytest.raises(ValueError, match="mine"):
        fail()
    assert list(tmp_path.iterdir()) == []


def test_a_link_is_not_written_through(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "result").symlink_to("elsewhere")
    with pytest.raises(DatasetError, match="exists already"), new_output(tmp_path / "result"):
        pass


def test_a_merge_removes_what_a_killed_merge_left(dataset: Path, tmp_path: Path) -> None:
    with start(tmp_path / "merged", "folder", "dies") as process:
        process.wait(20)
    edit.merge([dataset], tmp_path / "merged")
    assert len(Dataset.open(tmp_path / "merged")) == 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dataset", "merged"]


@pytest.mark.parametrize("how", ["merge", "import", "export"])
def test_a_result_is_brought_to_the_disk_once_before_it_gets_its_name(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    out, lerobot = tmp_path / "out", tmp_path / "lerobot"
    if how == "import":
        export_lerobot(Dataset.open(dataset), lerobot)
    synced: list[str] = []
    sync, sync_all = os.fsync, durable.sync_file_system

    def record(fd: int) -> None:
        synced.append(os.readlink(f"/proc/self/fd/{fd}"))
        sync(fd)

    def record_all(fd: int) -> None:
        assert not out.exists()
        (partial,) = tmp_path.glob(".out.partial-????????")
        assert how == "export" or len(Dataset.open(partial)) == 3
        synced.append("all")
        sync_all(fd)

    monkeypatch.setattr("os.fsync", record)
    monkeypatch.setattr("rcs_data.files.durable.sync_file_system", record_all)
    if how == "merge":
        edit.merge([dataset], out)
    elif how == "import":
        import_lerobot(lerobot, out)
    else:
        export_lerobot(Dataset.open(dataset), out)
    assert synced == ["all", str(tmp_path)], "everything, and then its name"
    edit.relabel(dataset, "push")
    assert len(synced) > 2, "an edit in place syncs what it writes"


@pytest.mark.parametrize("place", ["episodes/more", "episodes/000000/deep/more", "open/x", "former/x", ".trash/x"])
def test_nothing_is_put_into_the_folders_of_a_dataset(dataset: Path, place: str) -> None:
    before = sorted(dataset.rglob("*"))
    with pytest.raises(DatasetError, match=f"is in {place.split('/')[0]}/ of the dataset"), new_output(dataset / place):
        pass
    assert sorted(dataset.rglob("*")) == before


def test_what_can_be_written_is_found_out_and_nothing_is_left(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for path in (tmp_path, tmp_path / "new", tmp_path / "new" / "deep"):
        require_writable(path)
    for path in (tmp_path / "file", tmp_path / "new.json", tmp_path / "new" / "deep.json"):
        require_writable(path, is_file=True)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize(
    ("path", "is_file", "words"),
    [
        ("file", False, "Not a directory"),
        ("file/deep/folder", False, "Not a directory"),
        ("file/new.json", True, "Not a directory"),
        (".", True, "is a folder"),
        ("/proc/none/folder", False, "No such file"),
    ],
)
def test_what_cannot_be_written_is_refused(tmp_path: Path, path: str, is_file: bool, words: str) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(DatasetError, match=words):
        require_writable(tmp_path / path, is_file=is_file)


@pytest.mark.parametrize("doing", [None, "record rows"])
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EDQUOT])
def test_a_full_disk_says_to_repeat_what_left_nothing(tmp_path: Path, code: int, doing: str | None) -> None:
    out = tmp_path / "result"
    rows = contextlib.nullcontext() if doing is None else disk_errors(doing, out, keeps_rows=True)
    with pytest.raises(DatasetError) as told, new_output(out), rows:
        raise OSError(code, os.strerror(code))
    words = str(told.value)
    assert f"Could not write in {out}: {os.strerror(code)}" in words
    assert "ree some space, then repeat it" in words
    assert "recover" not in words
    assert not list(tmp_path.iterdir())


def test_an_error_of_another_place_keeps_its_words(tmp_path: Path) -> None:
    source = tmp_path / "source"
    told = r"Could not read rows in .*source: No such file"
    with pytest.raises(DatasetError, match=told), new_output(tmp_path / "out"), disk_errors("read rows", source):
        source.read_bytes()
