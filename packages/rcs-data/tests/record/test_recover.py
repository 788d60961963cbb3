"""A kill at any moment loses no finished episode, at most a second of the open one, and mixes nothing."""

from __future__ import annotations

import itertools
import random
import shutil
import signal
import struct
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
import pytest
from rcs_data import Dataset, DatasetWriter, EpisodeRecord, check, recover
from rcs_data.errors import DatasetError
from rcs_data.files.layout import OPEN_FOLDER

if TYPE_CHECKING:
    from conftest import MakeInfo, MakeRows, Record

STATE = 5  # the sim_state_size of make_info

HERE = Path(__file__).parent


@pytest.fixture(scope="module", params=[pytest.param(1, marks=pytest.mark.slow), 5])
def killed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Datasets of writers that were killed before each of their calls in turn, or before every fifth."""
    folder = tmp_path_factory.mktemp("killed")
    program = [sys.executable, HERE / "kill_every_call.py", folder, str(request.param)]
    subprocess.run(program, check=True, timeout=300)
    return folder


def test_a_kill_before_any_call_leaves_old_or_new_and_never_both(killed: Path) -> None:
    datasets = sorted((path for path in killed.iterdir() if path.is_dir()), key=lambda path: int(path.name))
    assert len(datasets) > 8, "the kill must have hit more than a few calls"
    hashes: dict[str, set[str]] = {"first": set(), "second": set()}
    for path in datasets:
        progress = (killed / f"{path.name}.progress").read_text().split()
        if "opened" not in progress and not (path / "episodes.jsonl").exists():
            continue
        before = {episode.id for episode in Dataset.open(path).episodes}
        recover(path)
        assert str(recover(path)) == "nothing to recover", path
        assert check(path).is_ok, check(path)
        episodes = {episode.id: episode for episode in Dataset.open(path).episodes}
        assert before <= episodes.keys()
        assert {name for name in ("first", "second") if name in progress} <= episodes.keys()
        if "discarded" in progress or "second" in episodes:
            assert "discarded" not in episodes, path
        for value, name in enumerate(("first", "discarded", "second")):
            if name in episodes:
                _expect_rows_of_one_take(episodes[name], value, is_finished=name in progress)
                if name in hashes and episodes[name].success:
                    hashes[name].add(episodes[name].content_hash)
    assert [len(found) for found in hashes.values()] == [1, 1]


def _expect_rows_of_one_take(episode: EpisodeRecord, value: int, *, is_finished: bool) -> None:
    joints = episode.column("observation/joints")
    assert (joints == value).all()
    assert (episode.sim_state() == value).all()
    assert len(episode.sim_state()) == len(joints) == episode.length
    assert episode.seed == value
    if is_finished or episode.success:
        assert episode.length == 70
    else:
        assert episode.outcome == {"recovered": True}
        assert episode.about["ended"] is None, "nobody saw when it ended"
        assert episode.length >= 1


def test_a_dataset_whose_making_was_killed_can_be_made_again(killed: Path, make_info: MakeInfo, record: Record) -> None:
    unmade = [path for path in killed.iterdir() if path.is_dir() and not (path / "episodes.jsonl").exists()]
    assert unmade
    for path in unmade:
        with DatasetWriter.open(path, make_info()) as writer:
            record(writer, "a")
        assert check(path).is_ok


@pytest.mark.parametrize("trial", range(3))
def test_sigkill_at_a_random_moment_loses_at_most_a_second(tmp_path: Path, trial: int) -> None:
    command = [sys.executable, HERE / "record_until_killed.py", tmp_path / "dataset"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        lines = [writer.stdout.readline()]
        time.sleep(random.Random(trial).uniform(0.05, 0.6))
        writer.send_signal(signal.SIGKILL)
        lines += writer.stdout.read().splitlines()
    added = {int(number): float(moment) for number, moment in (line.split() for line in lines if line.strip())}
    finished = (tmp_path / "dataset/episodes/done/steps.parquet").read_bytes()
    report = recover(tmp_path / "dataset")
    assert report.recovered == ("open",)
    dataset = Dataset.open(tmp_path / "dataset")
    numbers = dataset["open"].column("observation/number")
    np.testing.assert_array_equal(numbers, np.arange(len(numbers)))
    last = max(added.values())
    assert all(number < len(numbers) for number, moment in added.items() if moment < last - 0.5)
    assert len(list(dataset["open"].frames("observation/frames/wrist/rgb"))) == len(numbers)
    assert (tmp_path / "dataset/episodes/done/steps.parquet").read_bytes() == finished
    assert check(tmp_path / "dataset").is_ok


@pytest.mark.parametrize("rounds", [1, 33, 90])
def test_sigkill_with_24_open_episodes_mixes_nothing_and_each_comes_back(tmp_path: Path, rounds: int) -> None:
    command = [sys.executable, HERE / "record_until_killed.py", tmp_path / "dataset", "24"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        lines = list(itertools.islice(writer.stdout, 24 * rounds))
        writer.send_signal(signal.SIGKILL)
        lines += writer.stdout.read().splitlines()
    done = [line.split() for line in lines]
    finished = {name for name, what in done if what == "finished"}
    added = Counter(name for name, what in done if what == "added")
    recover(tmp_path / "dataset")
    assert check(tmp_path / "dataset").is_ok
    episodes = {episode.id: episode for episode in Dataset.open(tmp_path / "dataset").episodes}
    assert finished <= {name for name, episode in episodes.items() if episode.success}
    for name, rows in added.items():
        is_in_background = int(name[:2]) % 2
        if name in finished:
            assert episodes[name].length == rows == 20 + int(name[:2])
        elif not is_in_background:  # where what waits for the threads is lost with them
            assert episodes[name].length >= rows - 10, "half a second of the dataset's rate is in memory"
    for name, episode in episodes.items():
        numbers = episode.column("observation/number")
        np.testing.assert_array_equal(numbers, 10_000 * int(name[:2]) + np.arange(len(numbers)))
        colours = [np.unique(frame) for frame in episode.frames("observation/frames/wrist/rgb")]
        np.testing.assert_allclose(np.array(colours), 10 * int(name[:2]), atol=2)
        assert len(colours) == len(numbers)


def test_an_aborted_episode_comes_back_with_its_reason(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows
) -> None:
    def record_and_fail(writer: DatasetWriter) -> None:
        with writer.episode("a", seed=4, instruction="push") as episode:
            for row in make_rows(5):
                episode.add(row, np.zeros(STATE))
            raise RuntimeError("the gripper is gone")

    with DatasetWriter.open(tmp_path, make_info()) as writer, pytest.raises(RuntimeError):
        record_and_fail(writer)
    assert recover(tmp_path).recovered == ("a",)
    (found,) = Dataset.open(tmp_path).episodes
    assert found.outcome == {"recovered": True, "aborted": "RuntimeError: the gripper is gone"}
    assert (found.seed, found.instruction, found.success, found.length) == (4, "push", None, 5)


def test_a_torn_tail_is_cut_and_an_empty_episode_removed(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows
) -> None:
    with DatasetWriter.open(tmp_path, make_info()) as writer:
        for name in ("torn", "headless"):
            episode = writer.episode(name, seed=0)
            for row in make_rows(5):
                episode.add(row, np.zeros(STATE))
            episode.abort("for the test")
    for name, size in (("torn", -9), ("headless", 40)):
        stream = tmp_path / OPEN_FOLDER / name / "rows.arrows"
        stream.write_bytes(stream.read_bytes()[:size])
    (tmp_path / OPEN_FOLDER / "bare").mkdir()
    left = (tmp_path / OPEN_FOLDER / "torn" / "rows.arrows").read_bytes()
    report = recover(tmp_path)
    assert (report.recovered, report.removed) == (("torn",), ("bare", "headless"))
    assert "recovered torn, up to the last row that can be read" in str(report)
    assert (tmp_path / "quarantine/open-torn.arrows").read_bytes() == left
    (found,) = Dataset.open(tmp_path).episodes
    assert found.length == 1, "the reset is a batch of its own, and the other rows were one"
    assert found.timing["is_torn"]


@pytest.fixture
def each_row_flushed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs_data.record.episode_writer._FLUSH_AFTER_S", -1.0)


@pytest.fixture
def stream(tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows) -> Path:
    """The stream of an episode that was left open with five rows, all joints of which are at 1234.5."""
    with DatasetWriter.open(tmp_path, make_info()) as writer:
        episode = writer.episode("a", seed=0)
        for row in make_rows(5):
            episode.add({**row, "observation/joints": np.full(3, 1234.5)}, np.zeros(STATE))
        episode.abort("for the test")
    return tmp_path / OPEN_FOLDER / "a" / "rows.arrows"


def header_size(stream: Path) -> int:
    with pa.OSFile(str(stream)) as source:
        pa.ipc.open_stream(source)
        return source.tell()


@pytest.mark.parametrize("has_checksums", [True, False])
@pytest.mark.parametrize("place", ["header", "first batch"])
def test_rows_behind_a_damaged_start_are_left_alone(
    tmp_path: Path, stream: Path, place: str, has_checksums: bool
) -> None:
    data = bytearray(stream.read_bytes())
    start = 0 if place == "header" else header_size(stream)
    data[start : start + 8] = bytes(8)
    stream.write_bytes(data)
    if not has_checksums:
        stream.with_name("rows.crc").unlink(missing_ok=True)
    report = recover(tmp_path)
    assert [name for name, _ in report.failed] == ["a"]
    assert stream.read_bytes() == data
    assert len(Dataset.open(tmp_path)) == 0


def test_a_number_that_changed_on_the_disk_is_not_taken_for_data(tmp_path: Path, stream: Path) -> None:
    data = bytearray(stream.read_bytes())
    data[data.index(struct.pack("<d", 1234.5)) + 5] ^= 1
    stream.write_bytes(data)
    report = recover(tmp_path)
    assert [name for name, _ in report.failed] == ["a"]
    assert "is not what was written" in str(report)
    assert stream.read_bytes() == data


@pytest.mark.usefixtures("each_row_flushed")
def test_rows_before_a_last_one_that_a_loss_of_power_left_empty_become_an_episode(tmp_path: Path, stream: Path) -> None:
    data = bytearray(stream.read_bytes())
    size = struct.unpack("<2I", stream.with_name("rows.crc").read_bytes()[-8:])[0]
    data[-size:] = bytes(size)
    stream.write_bytes(data)
    report = recover(tmp_path)
    assert (report.recovered, report.cut) == (("a",), ("a",))
    assert Dataset.open(tmp_path)["a"].length == 4


def test_half_of_the_first_row_is_no_row(tmp_path: Path, stream: Path) -> None:
    stream.write_bytes(stream.read_bytes()[: header_size(stream) + 100])
    checksums = stream.with_name("rows.crc")
    checksums.write_bytes(checksums.read_bytes()[:8])  # that of the header
    assert recover(tmp_path).removed == ("a",)


def test_a_stream_of_another_dataset_is_left_alone(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows, record: Record
) -> None:
    with DatasetWriter.open(tmp_path / "a", make_info(images=True)) as writer:
        record(writer, "good")
    with DatasetWriter.open(tmp_path / "b", make_info()) as writer:
        writer.episode("odd", seed=0).add(make_rows(1)[0], np.zeros(STATE))
    shutil.copytree(tmp_path / "b" / OPEN_FOLDER / "odd", tmp_path / "a" / OPEN_FOLDER / "odd")
    report = recover(tmp_path / "a")
    assert report.failed[0][0] == "odd"
    assert "other columns" in str(report)
    assert (tmp_path / "a" / OPEN_FOLDER / "odd" / "rows.arrows").exists()


def test_a_dataset_that_is_being_written_is_not_recovered(tmp_path: Path, make_info: MakeInfo) -> None:
    with DatasetWriter.open(tmp_path, make_info()), pytest.raises(DatasetError, match="Another writer"):
        recover(tmp_path)


def test_where_there_is_no_dataset_nothing_is_made(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no dataset"):
        recover(tmp_path / "nowhere")
    assert not (tmp_path / "nowhere").exists()
