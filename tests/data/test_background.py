"""An episode written by a thread: the same bytes, a loop that never waits, and nothing lost without a word."""

from __future__ import annotations

import logging
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rcs.data import Dataset, DatasetInfo, DatasetWriter, EpisodeWriter, Feature, recover, steps_equal
from rcs.data.background import BackgroundEpisode
from rcs.data.flags import FrameFlag
from rcs.errors import DatasetError, InvalidSetup

RGB, FLAGS, JOINTS = "observation/frames/wrist/rgb", "flags/frames/wrist", "observation/joints"
SHAPE = (48, 64, 3)
INFO = DatasetInfo(
    fps=100.0,
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
    """Holds the writing thread back until it is opened."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.open = threading.Event()
        add = EpisodeWriter.add

        def wait_and_add(writer: EpisodeWriter, *given: Any) -> None:
            assert self.open.wait(10)
            add(writer, *given)

        monkeypatch.setattr(EpisodeWriter, "add", wait_and_add)


def start(writer: DatasetWriter, name: str = "a", **settings: Any) -> BackgroundEpisode:
    return BackgroundEpisode(writer.episode(name, seed=0), INFO, **settings)


def test_a_thread_writes_what_would_be_written_without_one(tmp_path: Path) -> None:
    with DatasetWriter.open(tmp_path, INFO) as writer:
        here, there = writer.episode("a", seed=0), start(writer, "b")
        for row in rows(50):
            here.add(row)
            there.add(row)
        first, second = here.finish(True), there.finish(True)
    assert steps_equal(first.steps(), second.steps())
    assert second.quality["writer"]["dropped_images"] == second.quality["writer"]["dropped_rows"] == 0
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
    gate = Gate(monkeypatch)
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
    assert dropped.sum() == record.quality["writer"]["dropped_images"] == 30
    assert record.quality["cameras"][RGB]["dropped"] == 30
    assert record.quality["writer"]["most_bytes_waiting"] <= 10 * IMAGE_BYTES
    assert [bool(flag & 1) for flag in flags] == [bool(row[FLAGS]) for row in given]  # what was said before stays
    assert caplog.text.count("slower than the loop") == 1


def test_even_the_rows_that_wait_are_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("rcs.data.background._MAX_ROWS", 8)
    gate = Gate(monkeypatch)
    with DatasetWriter.open(tmp_path, INFO) as writer:
        episode = start(writer)
        for row in rows(20):
            episode.add(row)
        gate.open.set()
        record = episode.finish(True)
    assert record.quality["writer"]["dropped_rows"] == 20 - record.length
    assert 8 <= record.length <= 9  # one may be in the thread's hands
    assert "rows are left out" in caplog.text


def test_a_bad_row_is_refused_at_once_and_the_episode_goes_on(tmp_path: Path) -> None:
    good = rows(3)
    with DatasetWriter.open(tmp_path, INFO) as writer:
        episode = start(writer)
        episode.add(good[0])
        with pytest.raises(InvalidSetup, match="expected is"):
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
            patch.setattr("rcs.data.durable.os.write", full)
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
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("write episode")]


def test_closing_the_dataset_writes_what_waits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gate = Gate(monkeypatch)
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
