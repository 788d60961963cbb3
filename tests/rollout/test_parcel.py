"""What a worker writes in its own folder travels with its results, and nothing stays behind."""

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
from rcs.rollout.parcel import Courier, Luggage, Parcel, packed

DYING = """
import os, signal, sys, tempfile
from pathlib import Path
from rcs.rollout.parcel import Courier
tempfile.tempdir = sys.argv[1]
courier = Courier(lambda folder: folder.mkdir())
os.kill(os.getpid(), signal.SIGKILL)
"""


class Writes:
    """A worker that writes its number into a file, and below a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
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
    courier = Courier(Writes, outbox="out")
    first, second = courier.attempt(1), courier.attempt(2)
    assert (first.result, second.result) == (-1, -2)
    assert set(first.files) == {"deep/1", "empty"} and set(second.files) == {"deep/2", "empty"}
    assert bytes(second.by_folder()["deep"]["2"]) == b"the number 2"
    courier.close()


def test_files_arrive_as_they_were_sent(place: Path, tmp_path: Path) -> None:
    courier = Courier(Writes)
    sent = courier.attempt(7)
    arrived: Parcel = pickle.loads(pickle.dumps(sent))
    arrived.unpack(tmp_path / "there")
    there = {path: data.tobytes() for path, data in packed(tmp_path / "there").items()}
    assert there == {"out/deep/7": b"the number 7", "out/empty": b"", "own": b""}
    courier.close()


@pytest.mark.parametrize("kind", ["folder", "file"])
def test_luggage_has_its_name_and_contents_where_it_arrives(tmp_path: Path, kind: str) -> None:
    (tmp_path / "here/checkpoint/deep").mkdir(parents=True)
    (tmp_path / "here/checkpoint/weights").write_bytes(b"\0\1")
    (tmp_path / "here/checkpoint/deep/more").touch()
    path = tmp_path / ("here/checkpoint" if kind == "folder" else "here/checkpoint/weights")
    arrived: Luggage = pickle.loads(pickle.dumps(Luggage.of(path)))
    place = arrived.unpack(tmp_path / "there")
    assert place.name == path.name
    if kind == "folder":
        assert (place / "weights").read_bytes() == b"\0\1" and (place / "deep/more").read_bytes() == b""
    else:
        assert place.read_bytes() == b"\0\1"


def test_a_courier_leaves_nothing_behind(place: Path) -> None:
    courier = Courier(Writes)
    assert list(place.iterdir())
    courier.close()
    assert list(place.iterdir()) == []


def test_a_courier_whose_worker_cannot_be_made_leaves_nothing_behind(place: Path) -> None:
    def make(folder: Path) -> Writes:
        folder.mkdir()
        raise InvalidSetup("no such robot")

    with pytest.raises(InvalidSetup, match="no such robot"):
        Courier(make)
    assert list(place.iterdir()) == []


def test_what_a_killed_worker_left_is_removed_by_the_next_one(place: Path, caplog: pytest.LogCaptureFixture) -> None:
    with subprocess.Popen([sys.executable, "-c", DYING, str(place)]) as process:
        assert process.wait(60) == -signal.SIGKILL
    assert len(list(place.iterdir())) == 2
    with caplog.at_level(logging.ERROR):
        courier = Courier(Writes)
        courier.close()
    assert list(place.iterdir()) == []
