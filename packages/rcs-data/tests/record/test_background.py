"""An episode written by threads: the same bytes, a loop that never waits, and nothing lost without a word."""

from __future__ import annotations

import itertools
import logging
import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, EpisodeWriter, Feature, recover
from rcs_data.errors import DatasetError, InvalidSetup, WrongOrder
from rcs_data.files.codec import encode_frame
from rcs_data.files.flags import FrameFlag
from rcs_data.record.background import MOST_THREADS, BackgroundEpisode

RGB, FLAGS, JOINTS = "observation/frames/wrist/rgb", "flags/frames/wrist", "observation/joints"
SHAPE = (48, 64, 3)
INFO = DatasetInfo(
    frequency=100.0,
    features=(
        Feature(key=JOINTS, shape=(2,), dtype="float64"),
        Feature(key=RGB, shape=SHAPE, dtype="uint8", encoding="jpeg"),
        Feature(key=FLAGS, shape=(), dtype="uint8"),
    ),
    setup={},
    instruction="",
)
IMAGE_BYTES = int(np.prod(SHAPE))


def rows(n: int) -> list[dict[str, Any]]:
    rng = np.random.default_rng(3)
    return [
        {JOINTS: rng.normal(size=2), RGB: rng.integers(0, 256, SHAPE, np.uint8), FLAGS: int(i % 7 == 1)}
        for i in range(n)
    ]


class Gate:
    """Holds back what encodes ("encode_frame") or what writes ("EpisodeWriter.add") until it is opened."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, what: str) -> None:
        self.open = threading.Event()
        real = encode_frame if what == "encode_frame" else EpisodeWriter.add

        def wait(*given: Any) -> Any:
            assert self.open.wait(60)
            return real(*given)

        monkeypatch.setattr(f"rcs_data.record.background.{what}", wait)


def encoding_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name.startswith("encode")]


def start(writer: DatasetWriter, name: str = "a", **settings: Any) -> BackgroundEpisode:
    return BackgroundEpisode(writer.episode(name, seed=0), **settings)


@pytest.mark.parametrize("threads", [1, 4])
def test_threads_write_what_would_be_written_without_any(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threads: int
) -> None:
    delays = itertools.cycle([0.003, 0.0, 0.001, 0.002, 0.0])

    def encode_in_disorder(*given: Any) -> bytes:
        time.sleep(next(delays))
        return encode_frame(*given)

    monkeypatch.setattr("rcs_data.record.background.encode_frame", encode_in_disorder)
    monkeypatch.setattr("rcs_data.record.background._usable_cpus", lambda: threads)
    with DatasetWriter.open(tmp_path, INFO) as writer:
        here, there = writer.episode("a", seed=0), start(writer, "b")
        assert len(encoding_threads()) == threads
        for i, row in enumerate(rows(50)):
            taken = {**row, RGB: None} if i % 3 == 1 else row
            here.add(taken)
            there.add(taken)
        first, second = here.finish(True), there.finish(True)
    assert second.timing["writer"]["dropped_images"] == second.timing["writer"]["dropped_rows"] == 0
    assert first.content_hash == second.content_hash


def test_arrays_may_change_after_they_were_given(tmp_path: Path) -> None:
    given = rows(20)
    wanted = [row[JOINTS].copy() for row in given]
    with DatasetWriter.open(tmp_path, INFO) as writer:
        episode = start(writer)
        for row in given:
            episode.add(row)
            row[JOINTS][:] = 0
            row[RGB][:] = 0
        record = episode.finish(None)
    np.testing.assert_array_equal(record.column(JOINTS), wanted)
    assert all(frame.mean() > 100 for frame in record.frames(RGB))


def test_when_the_writer_is_too_slow_images_are_left_out_flagged_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    gate = Gate(monkeypatch, "encode_frame")
    given = rows(40)
    with DatasetWriter.open(tmp_path, INFO) as writer, caplog.at_level(logging.WARNING):
        episode = start(writer, bound_bytes=10 * IMAGE_BYTES)
        for row in given:
            episode.add(row)  # never waits: the gate is shut
        gate.open.set()
        record = episode.finish(True)
    flags = record.flags("wrist")
    dropped = (flags & FrameFlag.DROPPED).astype(bool)
    assert record.length == 40
    np.testing.assert_array_equal(record.column(JOINTS), [row[JOINTS] for row in given])
    assert dropped.sum() == record.timing["writer"]["dropped_images"] == 30
    assert record.timing["cameras"][RGB]["dropped"] == 30
    assert record.timing["writer"]["most_bytes_waiting"] <= 10 * IMAGE_BYTES
    assert [bool(flag & 1) for flag in flags] == [bool(row[FLAGS]) for row in given]  # what was said before stays
    assert caplog.text.count("slower than the loop") == 1


def test_rows_that_repeat_an_image_that_was_left_out_are_flagged_until_the_next_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate(monkeypatch, "encode_frame")
    given = [{**row, FLAGS: 0} for row in rows(6)]
    given[2] |= {RGB: None}  # the camera gave nothing
    for i in (3, 5):
        given[i] |= {RGB: None, FLAGS: int(FrameFlag.REPEATED)}
    with DatasetWriter.open(tmp_path, INFO) as writer:
        episode = start(writer, bound_bytes=IMAGE_BYTES)
        for row in given[:4]:
            episode.add(row)  # the first image is kept, the second is not
        gate.open.set()
        while episode._encoders.waiting_bytes:
            time.sleep(0.001)
        for row in given[4:]:
            episode.add(row)
        record = episode.finish(True)
    old, lost = FrameFlag.REPEATED, FrameFlag.DROPPED
    assert record.flags("wrist").tolist() == [0, lost, FrameFlag.MISSING, lost | old, 0, old]
    assert record.timing["writer"]["dropped_images"] == 1


def test_even_the_rows_that_wait_are_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("rcs_data.record.background._MAX_ROWS", 8)
    gate = Gate(monkeypatch, "EpisodeWriter.add")
    with DatasetWriter.open(tmp_path, INFO) as writer:
        episode = start(writer)
        for row in rows(20):
            episode.add(row)
        gate.open.set()
        record = episode.finish(True)
    assert record.timing["writer"]["dropped_rows"] == 20 - record.length
    assert 8 <= record.length <= 9  # one may be in the thread's hands
    assert "rows are dropped" in caplog.text


def test_encoded_images_that_wait_for_a_disk_are_bounded_as_well(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate(monkeypatch, "EpisodeWriter.add")
    with DatasetWriter.open(tmp_path, INFO) as writer:
        episode = start(writer, bound_bytes=10 * IMAGE_BYTES)
        for row in rows(100):
            episode.add(row)
        gate.open.set()
        record = episode.finish(True)
    writing = record.timing["writer"]
    assert record.length == 100
    assert np.count_nonzero(record.flags("wrist") & FrameFlag.DROPPED) == writing["dropped_images"] > 0
    assert writing["most_bytes_waiting"] <= 10 * IMAGE_BYTES


def test_all_episodes_together_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Gate(monkeypatch, "encode_frame")
    with DatasetWriter.open(tmp_path, INFO) as writer:
        episodes = [start(writer, f"{i}", bound_bytes=10 * IMAGE_BYTES) for i in range(4)]
        for row in rows(5):
            for episode in episodes:
                episode.add(row)
        gate.open.set()
        records = [episode.finish(True) for episode in episodes]
        assert sum(record.timing["writer"]["dropped_images"] for record in records) == 4 * 5 - 10
        last = start(writer, "last", bound_bytes=IMAGE_BYTES)
        last.add(rows(1)[0])
        assert last.finish(True).timing["writer"]["dropped_images"] == 0, "what was written waits no more"


def test_an_array_that_nobody_can_write_to_is_taken_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []
    monkeypatch.setattr(
        "rcs_data.record.background.encode_frame", lambda *given: seen.append(given[1]) or b"\xff\xd8\xff\xd9"
    )
    frozen, (row,) = np.zeros(SHAPE, np.uint8), rows(1)
    view = frozen.view()
    frozen.flags.writeable = view.flags.writeable = False
    behind = np.zeros(SHAPE, np.uint8)
    window = behind.view()
    window.flags.writeable = False  # but not what it looks at
    monkeypatch.setattr("rcs_data.record.background._usable_cpus", lambda: 1)  # so that they are encoded in order
    with DatasetWriter.open(tmp_path, INFO) as writer, start(writer) as episode:
        for image in (frozen, view, window, behind):
            episode.add({**row, RGB: image})
    assert seen[0] is frozen
    assert seen[1] is view
    assert not np.shares_memory(seen[2], behind)
    assert not np.shares_memory(seen[3], behind)


def test_an_image_that_cannot_be_encoded_is_told_and_the_rows_before_it_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = rows(20)

    def fail(feature: Feature, image: Any, info: DatasetInfo) -> bytes:
        if np.array_equal(image, given[12][RGB]):
            raise MemoryError("no room for a picture")
        return encode_frame(feature, image, info)

    monkeypatch.setattr("rcs_data.record.background.encode_frame", fail)
    with DatasetWriter.open(tmp_path, INFO) as writer:
        episode = start(writer)
        with pytest.raises(MemoryError, match="no room"):  # noqa: PT012  by which call it is told depends on the threads
            for row in given:
                episode.add(row)
            episode.finish(True)
    assert recover(tmp_path).recovered == ("a",)
    assert Dataset.open(tmp_path)["a"].length == 12


def test_after_a_finish_that_was_refused_rows_go_on(tmp_path: Path) -> None:
    with DatasetWriter.open(tmp_path, INFO) as writer:
        episode = start(writer)
        for row in rows(10):
            episode.add(row)
        with pytest.raises(InvalidSetup, match="success is 'yes'"):
            episode.finish("yes")  # pyright: ignore[reportArgumentType]
        for row in rows(5):
            episode.add(row)
        assert episode.finish(True).length == 15


def test_episodes_share_threads_that_end_with_the_last_of_them(tmp_path: Path) -> None:
    with DatasetWriter.open(tmp_path, INFO) as writer:
        episodes = [start(writer, f"{i}") for i in range(24)]
        for row in rows(3):
            for episode in episodes:
                episode.add(row)
        assert 1 <= len(encoding_threads()) <= MOST_THREADS
        for episode in episodes[:-1]:
            episode.finish(True)
        assert encoding_threads()
        episodes[-1].discard()
    assert not encoding_threads()


def test_a_forked_process_has_threads_of_its_own(tmp_path: Path) -> None:
    with DatasetWriter.open(tmp_path / "parent", INFO) as writer:
        episode = start(writer)
        episode.add(rows(1)[0])
        child = os.fork()
        if child == 0:
            signal.alarm(60)  # ends it where it would wait for a thread that is not there
            with DatasetWriter.open(tmp_path / "child", INFO) as own:
                another = start(own)
                for row in rows(5):
                    another.add(row)
                another.finish(True)
            os._exit(0)
        _, status = os.waitpid(child, 0)
        assert status == 0
        episode.finish(True)
    assert [Dataset.open(tmp_path / name)["a"].length for name in ("parent", "child")] == [1, 5]


def test_threads_that_have_ended_take_nothing(tmp_path: Path) -> None:
    first, second = rows(2)
    with DatasetWriter.open(tmp_path, INFO) as writer:
        episode = start(writer)
        episode.add(first)
        episode.finish(True)
        with pytest.raises(WrongOrder, match="encoders are closed"):
            episode.add(second)


def test_a_bad_row_is_refused_at_once_and_the_episode_goes_on(tmp_path: Path) -> None:
    good = rows(3)
    with DatasetWriter.open(tmp_path, INFO) as writer:
        episode = start(writer)
        episode.add(good[0])
        with pytest.raises(InvalidSetup, match="expected"):
            episode.add({**good[1], JOINTS: np.zeros(5)})
        episode.add(good[2])
        assert episode.finish(True).length == 2


def test_a_disk_that_fails_is_told_with_the_next_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with DatasetWriter.open(tmp_path, INFO) as writer:
        start(writer, "earlier").__exit__(None, None, None)
        kept = start(writer, "kept")
        kept.add(rows(1)[0])
        kept.finish(True)
        episode = start(writer)
        episode.add(rows(1)[0])

        def full(*_: object) -> int:
            raise OSError(28, "No space left on device")

        with monkeypatch.context() as patch:
            patch.setattr("rcs_data.files.durable.os.write", full)
            with pytest.raises(DatasetError, match="No space left"):  # noqa: PT012
                for _ in range(500):
                    for row in rows(10):
                        episode.add(row)
                    time.sleep(0.01)
        assert episode.state == "aborted"
    assert [e.id for e in Dataset.open(tmp_path).episodes] == ["kept"]


def test_a_discarded_episode_leaves_no_byte_and_no_thread(tmp_path: Path) -> None:
    with DatasetWriter.open(tmp_path, INFO) as writer:
        episode = start(writer)
        for row in rows(20):
            episode.add(row)
        episode.discard()
        assert not list((tmp_path / "episodes").iterdir())
    assert not encoding_threads()


def test_closing_the_dataset_writes_what_waits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Gate(monkeypatch, "EpisodeWriter.add")
    with DatasetWriter.open(tmp_path, INFO) as writer:
        episode = start(writer)
        for row in rows(200):
            episode.add(row)
        threading.Timer(0.05, gate.open.set).start()
    assert episode.state == "aborted"
    assert recover(tmp_path).recovered == ("a",)
    assert Dataset.open(tmp_path)["a"].length == 200


def test_left_without_finish_the_rows_can_be_recovered(tmp_path: Path) -> None:
    with DatasetWriter.open(tmp_path, INFO) as writer, start(writer) as episode:
        for row in rows(20):
            episode.add(row)
    with DatasetWriter.open(tmp_path, INFO, resume=True) as writer:
        assert writer.recovered.recovered == ("a",)
    assert Dataset.open(tmp_path).episodes[0].length == 20
