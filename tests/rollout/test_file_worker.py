"""Files of a worker are returned with its results, and nothing stays behind."""

from __future__ import annotations

import logging
import pickle
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from rcs.errors import InvalidSetup
from rcs.rollout.ray_pool import FileWorker, read_files, write_files

DYING = """
import os, signal, sys, tempfile
from pathlib import Path
from rcs.rollout.ray_pool import FileWorker
tempfile.tempdir = sys.argv[1]
worker = FileWorker(lambda folder, agent: folder.mkdir() or open(os.devnull))
os.kill(os.getpid(), signal.SIGKILL)
"""


class Writes:
    """A worker that writes its number into a file, and below a folder."""

    def __init__(self, folder: Path, agent: object = None) -> None:
        self.folder, self.agent = folder, agent
        (folder / "out").mkdir(parents=True)
        (folder / "own").touch()

    def attempt(self, number: int) -> int:
        (self.folder / "out" / "deep").mkdir()
        (self.folder / "out" / "deep" / f"{number}").write_text(f"the number {number}")
        (self.folder / "out" / "empty").touch()
        return -number

    def close(self) -> None:
        return


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    return tmp_path / "temporary"


def test_each_result_takes_along_its_own_files_and_no_others(place: Path) -> None:
    worker = FileWorker(Writes, outbox="out")
    (first, files), (second, more) = worker.attempt(1), worker.attempt(2)
    assert (first, second) == (-1, -2)
    assert set(files) == {"deep/1", "empty"} and set(more) == {"deep/2", "empty"}
    assert bytes(more["deep/2"]) == b"the number 2"
    worker.close()


def test_files_arrive_as_they_were_sent(place: Path, tmp_path: Path) -> None:
    worker = FileWorker(Writes)
    sent = worker.attempt(7)
    write_files(pickle.loads(pickle.dumps(sent))[1], tmp_path / "there")
    there = {path: data.tobytes() for path, data in read_files(tmp_path / "there", tmp_path / "there").items()}
    assert there == {"out/deep/7": b"the number 7", "out/empty": b"", "own": b""}
    worker.close()


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_a_sent_checkpoint_has_its_name_and_contents(place: Path, tmp_path: Path, kind: str) -> None:
    (tmp_path / "here/checkpoint/deep").mkdir(parents=True)
    (tmp_path / "here/checkpoint/weights").write_bytes(b"\0\1")
    (tmp_path / "here/checkpoint/deep/more").touch()
    path = tmp_path / ("here/checkpoint" if kind == "folder" else "here/checkpoint/weights")
    sent = pickle.loads(pickle.dumps(read_files(path, path.parent)))
    made: list[Writes] = []
    worker = FileWorker(lambda folder, agent: made.append(Writes(folder, agent)) or made[0], "out", path.name, sent)
    there = made[0].agent
    assert isinstance(there, Path) and there.name == path.name
    if kind == "folder":
        assert (there / "weights").read_bytes() == b"\0\1" and (there / "deep/more").read_bytes() == b""
    else:
        assert there.read_bytes() == b"\0\1"
    worker.close()


def test_an_agent_that_is_no_path_is_sent_as_it_is(place: Path) -> None:
    made: list[Writes] = []
    FileWorker(lambda folder, agent: made.append(Writes(folder, agent)) or made[0], agent="expert").close()
    assert made[0].agent == "expert"


def test_a_worker_leaves_nothing_behind(place: Path) -> None:
    worker = FileWorker(Writes)
    assert list(place.iterdir())
    worker.close()
    assert list(place.iterdir()) == []


def test_a_worker_whose_worker_cannot_be_made_leaves_nothing_behind(place: Path) -> None:
    def make(folder: Path, agent: object) -> Writes:
        folder.mkdir()
        raise InvalidSetup("no such robot")

    with pytest.raises(InvalidSetup, match="no such robot"):
        FileWorker(make)
    assert list(place.iterdir()) == []


def test_what_a_killed_worker_left_is_removed_by_the_next_one(place: Path, caplog: pytest.LogCaptureFixture) -> None:
    with subprocess.Popen([sys.executable, "-c", DYING, str(place)]) as process:
        assert process.wait(60) == -signal.SIGKILL
    assert len(list(place.iterdir())) == 2
    with caplog.at_level(logging.ERROR):
        worker = FileWorker(Writes)
        worker.close()
    assert list(place.iterdir()) == []
