"""The faults that a recording must survive, one test each, from end to end; closer looks are named beside them.

 1  SIGKILL at any moment                      test_recover, integration/test_kill, benchmarks/kill.py
 2  SIGKILL while an episode is completed      test_recover (before every call that changes the disk)
 3  SIGTERM, Ctrl-C                            cli/test_cli
 4  full disk                                  test_episode_writer, test_background, edit/test_full_disk
 5  failing or read-only disk                  test_episode_writer
 6  torn tail, flipped bit                     test_stream, check/test_any_byte, check/test_bytes
 7  two recorders, lock of a dead one          test_lock, test_writer
 8  the wall clock jumps                       test_timing, check/test_times
 9  camera slower than the loop                envs/observers/test_recorder
10  camera stalls, fails, gives nonsense       envs/observers/test_recorder, check/test_images
11  writer slower than the loop                test_background
12  discarded take                             envs/observers/test_takes, test_episode_writer
13  resumed with another setup                 test_writer, test_info
14  edit killed midway                         edit/test_transaction
15  merge, then split                          edit/test_combine
16  empty, tiny, huge, odd names               test_episode_writer, test_writer
17  other versions of the layout               test_held, test_info, test_reader
"""

from __future__ import annotations

import datetime
import errno
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rcs_data import SCHEMA_VERSION, Dataset, DatasetInfo, DatasetWriter, EpisodeWriter, Feature, check, edit, recover
from rcs_data.errors import DatasetError, InvalidSetup
from rcs_data.files.durable import sealed, unsealed

import rcs
from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.observers.recorder import Recorder

if TYPE_CHECKING:
    from conftest import MakeInfo, MakeRows, Record

HERE = Path(__file__).parent
STATE = 5


class Loop:
    """A control loop on a simulated arm that is recorded."""

    def __init__(self, path: Path, **settings: Any) -> None:
        setup = rcs.Setup(task="Free", cameras=())
        self.env = rcs.make(setup)
        self.writer = DatasetWriter.open(path, dataset_info(self.env))
        self.recorder = Recorder(self.writer, **settings)
        self.env.add_observer(self.recorder)

    def steps(self, n: int) -> None:
        for _ in range(n):
            self.env.step(self.env.action_space.sample())

    def episode(self, name: str, n: int = 5) -> None:
        self.recorder.name_next(name, instruction="wait")
        self.env.reset(seed=1)
        self.steps(n)
        self.recorder.finish(True)

    def close(self) -> None:
        self.env.close()
        self.writer.close()


@pytest.fixture
def loop(tmp_path: Path) -> Iterator[Loop]:
    loop = Loop(tmp_path / "set")
    yield loop
    loop.close()


def endless(path: Path) -> subprocess.Popen[str]:
    """Start a program that finishes one episode and then records another without end; return when that is under way."""
    command = [sys.executable, HERE / "record/record_until_killed.py", path]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert process.stdout is not None
    process.stdout.readline()
    return process


def add_all(episode: EpisodeWriter, rows: list[dict[str, Any]]) -> None:
    for row in rows:
        episode.add(row, np.zeros(STATE))


def bytes_of(path: Path, episode: str) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in Dataset.open(path)[episode].path.iterdir()}


def test_1_sigkill_at_any_moment_costs_no_finished_episode_and_no_half_second_of_the_open_one(tmp_path: Path) -> None:
    path = tmp_path / "set"
    with endless(path) as process:
        finished = bytes_of(path, "done")
        time.sleep(random.uniform(0.3, 0.7))
        process.kill()
        assert process.stdout is not None
        rows = [float(line.split()[1]) for line in process.stdout.read().splitlines()[:-1]]
    assert recover(path).recovered == ("open",)
    kept = Dataset.open(path)["open"].length
    assert kept >= len(rows) or rows[-1] - rows[kept] < 0.5
    assert bytes_of(path, "done") == finished
    assert check(path).is_ok


def test_2_sigkill_while_an_episode_is_completed_leaves_it_open_or_complete(tmp_path: Path) -> None:
    program = "import sys; sys.path.insert(0, sys.argv[1]); import kill_every_call as k; from pathlib import Path\n"
    program += "k.die_before_call(int(sys.argv[2])); k.record(Path(sys.argv[3]), lambda _: None)"
    for n in (40, 46, 52, 58):  # among these the first episode becomes Parquet and gets its name
        path = tmp_path / str(n)
        killed = subprocess.run([sys.executable, "-c", program, HERE / "record", str(n), path], check=False)
        assert killed.returncode == 9
        recover(path)
        assert check(path).is_ok
        assert [episode.length > 0 for episode in Dataset.open(path).episodes] in ([], [True], [True, True])
        assert not list((path / "open").glob("*"))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_3_ctrl_c_and_sigterm_close_within_five_seconds(tmp_path: Path, number: signal.Signals) -> None:
    path = tmp_path / "set"
    command = [sys.executable, "-c", "from rcs.cli.main import main; main()", "collect", "PickCuboid"]
    command += ["--episodes", "500", "--workers", "1", "--cameras", "none", "--out", str(path)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 30
        while not list((path / "episodes").glob("0*/episode.json")):
            assert time.monotonic() < deadline, "no episode within 30 s"
            time.sleep(0.02)
        process.send_signal(number)
        start = time.monotonic()
        assert process.wait(10) == 130
        assert time.monotonic() - start < 5
        assert process.stderr is not None and "Traceback" not in process.stderr.read()
    recover(path)
    assert check(path).is_ok
    assert len(Dataset.open(path)) >= 1


def test_3_ctrl_c_in_a_loop_of_ones_own_keeps_every_row(tmp_path: Path) -> None:
    with endless(tmp_path / "set") as process:
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
        start = time.monotonic()
        process.wait(10)
        assert time.monotonic() - start < 5
        assert process.stdout is not None
        told = len(process.stdout.read().splitlines()) + 1
    recover(tmp_path / "set")
    assert Dataset.open(tmp_path / "set")["open"].length >= told


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 300 kB."""
    path = tmp_path / "disk"
    path.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", str(path)]
    if (
        os.geteuid()
        or not shutil.which("mount")
        or subprocess.run(command, check=False, capture_output=True).returncode
    ):
        pytest.skip("a small disk cannot be mounted here; the next test has the same error by another way")
    yield path
    subprocess.run(["umount", str(path)], check=True)


def test_4_a_disk_that_fills_up_keeps_what_was_finished(
    small_disk: Path, make_info: MakeInfo, make_rows: MakeRows, record: Record
) -> None:
    path = small_disk / "set"
    with DatasetWriter.open(path, make_info()) as writer:
        record(writer, "before")
        before = bytes_of(path, "before")
        rows = make_rows(2)
        episode = writer.episode("during", seed=1)
        episode.add(rows[0], np.zeros(STATE))
        rest = [rows[1]] * 20_000
        with pytest.raises(DatasetError, match="Free some space, then run recover"):
            add_all(episode, rest)
        assert episode.state == "aborted"
    assert bytes_of(path, "before") == before
    moved = shutil.copytree(path, small_disk.parent / "roomy")
    assert recover(moved).recovered == ("during",)
    assert check(moved).is_ok


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO, errno.EROFS])
def test_4_and_5_a_disk_that_fails_stops_the_robot_and_costs_no_other_episode(
    loop: Loop, monkeypatch: pytest.MonkeyPatch, code: int
) -> None:
    loop.episode("before")
    before = bytes_of(loop.writer.path, "before")
    holds: list[None] = []
    monkeypatch.setattr(loop.env.stack, "hold", lambda: holds.append(None))
    loop.recorder.name_next("during", instruction="wait")
    loop.env.reset(seed=2)
    loop.steps(3)

    def fail(*_: object) -> int:
        raise OSError(code, os.strerror(code))

    with monkeypatch.context() as patch:
        patch.setattr("os.write", fail)
        with pytest.raises(DatasetError, match=os.strerror(code)):
            loop.steps(200)
    assert holds, "the robot holds"
    assert bytes_of(loop.writer.path, "before") == before
    loop.close()
    assert recover(loop.writer.path).recovered == ("during",)
    assert check(loop.writer.path).is_ok


def test_6_a_torn_record_and_a_flipped_bit_are_located_and_all_else_reads(dataset: Path) -> None:
    steps = Dataset.open(dataset)["000001"].path / "steps.parquet"
    data = steps.read_bytes()
    for damaged in (data[:-100], data[:700] + bytes([data[700] ^ 1]) + data[701:]):
        steps.write_bytes(damaged)
        assert {finding.episode for finding in check(dataset).damage} == {"000001"}
        assert [len(Dataset.open(dataset)[name].steps()) for name in ("000000", "000002")] == [6, 8]


def test_7_a_second_recorder_is_refused_and_the_lock_of_a_dead_one_is_free(tmp_path: Path) -> None:
    with endless(tmp_path / "set") as process:
        info = Dataset.open(tmp_path / "set").info
        with pytest.raises(DatasetError, match=f"process {process.pid}, has"):
            DatasetWriter.open(tmp_path / "set", info, resume=True)
        process.kill()
        process.wait()
        with DatasetWriter.open(tmp_path / "set", info, resume=True) as writer:
            assert writer.recovered.recovered == ("open",)


def test_8_a_wall_clock_that_jumps_an_hour_moves_no_stamp(loop: Loop, monkeypatch: pytest.MonkeyPatch) -> None:
    real, jumps = time.time, iter([3600.0, -3600.0] * 10_000)

    class Jumping(datetime.datetime):
        @classmethod
        def now(cls, tz: datetime.tzinfo | None = None) -> datetime.datetime:
            return datetime.datetime.fromtimestamp(real() + next(jumps), tz)

    monkeypatch.setattr("time.time", lambda: real() + next(jumps))
    monkeypatch.setattr("rcs_data.record.episode_writer.datetime", Jumping)
    loop.episode("a", 30)
    episode = Dataset.open(loop.writer.path)["a"]
    assert episode.about["ended"] < episode.about["started"], "the clock did jump"
    assert (np.diff(episode.column("time/monotonic")) > 0).all()
    assert episode.timing["period"]["backwards"] == 0
    assert not check(loop.writer.path).findings


def test_12_nothing_of_a_discarded_take_is_in_the_next(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows
) -> None:
    def take(path: Path, *, after_a_discard: bool) -> bytes:
        with DatasetWriter.open(path, make_info(images=True)) as writer:
            if after_a_discard:
                with writer.episode("a", seed=0) as episode:
                    for row in make_rows(90, images=True, seed=9):
                        episode.add(row, np.ones(STATE))
                    episode.discard()
            with writer.episode("a", seed=0) as episode:
                for row in make_rows(20, images=True, seed=1):
                    episode.add(row, np.zeros(STATE))
                episode.finish(True)
        return bytes_of(path, "a")["steps.parquet"]

    assert take(tmp_path / "x", after_a_discard=True) == take(tmp_path / "y", after_a_discard=False)
    assert os.listdir(tmp_path / "x/episodes") == ["a"]


def test_13_a_resume_with_another_rate_camera_or_dtype_is_refused_with_what_differs(
    dataset: Path, make_info: MakeInfo
) -> None:
    info: DatasetInfo = make_info(images=True)
    camera = Feature(key="observation/frames/side/rgb", shape=(16, 24, 3), dtype="uint8", encoding="jpeg")
    joints = replace(info.features[0], dtype="float32")
    for other, words in (
        (replace(info, frequency=15.0), "frequency: the dataset has 30.0, this setup has 15.0"),
        (replace(info, features=(*info.features, camera)), "observation/frames/side/rgb: this setup has"),
        (replace(info, features=(joints, *info.features[1:])), "float64 .* this setup has .* float32"),
    ):
        with pytest.raises(DatasetError, match=words):
            DatasetWriter.open(dataset, other, resume=True)
    assert not check(dataset).findings


def test_14_an_edit_that_is_killed_is_there_or_not_and_can_be_undone(tmp_path: Path, dataset: Path) -> None:
    before = Dataset.open(dataset).digest()
    subprocess.run([sys.executable, HERE / "edit/kill_every_edit.py", dataset, tmp_path, "delete"], check=True)
    digests = {path: Dataset.open(path).digest() for path in tmp_path.iterdir() if path.name.isdigit()}
    assert len(digests) > 5
    assert len(set(digests.values())) == 2
    for path, digest in digests.items():
        if digest != before:
            edit.undo(path)
        assert Dataset.open(path).digest() == before


def test_15_what_was_merged_is_split_into_what_it_was(tmp_path: Path, make_info: MakeInfo, record: Record) -> None:
    digests: dict[str, str] = {}
    for name, seed in (("a", 1), ("b", 2)):
        with DatasetWriter.open(tmp_path / name, make_info()) as writer:
            record(writer, "000000", seed=seed)
            record(writer, f"00000{seed}", seed=seed + 5)
        digests[name] = Dataset.open(tmp_path / name).digest()
    edit.merge([tmp_path / "a", tmp_path / "b"], tmp_path / "both")
    parts = edit.split(tmp_path / "both", tmp_path / "parts")
    assert {name: part.digest() for name, part in parts.items()} == digests


def test_16_an_empty_episode_is_refused_and_odd_names_are_not(
    tmp_path: Path, make_info: MakeInfo, make_rows: MakeRows
) -> None:
    path = tmp_path / "a path with späces 🤖"
    words = "Nimm den „grünen“ Würfel 立方体"
    with DatasetWriter.open(path, make_info(instruction=words)) as writer:
        with writer.episode("leer", seed=0) as empty, pytest.raises(InvalidSetup, match="no rows"):
            empty.finish(True)
        with writer.episode("ein Bild ÷ 1", seed=0) as episode:
            episode.add(make_rows(1)[0], np.zeros(STATE))
            episode.finish(True)
    (kept,) = Dataset.open(path).episodes
    assert (kept.id, kept.length, kept.instruction) == ("ein Bild ÷ 1", 1, words)
    assert [finding.kind for finding in check(path).findings] == ["no_action"]


@pytest.mark.slow
def test_16_a_million_rows_are_written_read_and_checked(tmp_path: Path) -> None:
    count = 1_000_000
    features = [Feature(key=f"{kind}/joints", shape=(7,), dtype="float64") for kind in ("observation", "action")]
    info = DatasetInfo(frequency=1000, features=tuple(features), setup={}, instruction="wait")
    joints = np.zeros(7)
    with DatasetWriter.open(tmp_path, info) as writer, writer.episode("a", seed=0) as episode:
        episode.add({"observation/joints": joints})
        for _ in range(count - 1):
            episode.add({"observation/joints": joints, "action/joints": joints})
        episode.finish(True)
    assert Dataset.open(tmp_path)["a"].column("observation/joints").shape == (count, 7)
    report = check(tmp_path)
    assert (report.rows, report.findings) == (count, ())


def test_17_another_layout_is_refused_and_says_what_to_do(dataset: Path) -> None:
    path = dataset / "dataset.json"
    values = unsealed(path.read_bytes(), path)
    for version, remedy in ((SCHEMA_VERSION - 1, "Record it anew"), (SCHEMA_VERSION + 1, "Update this library")):
        path.write_bytes(sealed({**values, "schema_version": version}))
        for use in (Dataset.open, check, recover):
            with pytest.raises(DatasetError, match=remedy):
                use(dataset)
