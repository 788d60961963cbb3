"""Rows 9 to 11 of the fault list: cameras and disks that do not keep up, beside a loop that does."""

from __future__ import annotations

import logging
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetInfo, DatasetWriter, EpisodeWriter, Feature, check
from rcs_data.files.flags import FrameFlag
from rcs_data.record.background import BackgroundEpisode

from rcs.envs.observer import Transition
from rcs.envs.observers.recorder import Recorder
from rcs.errors import DeviceFault, InvalidSetup

RGB = "observation/frames/wrist/rgb"
PERIOD = 0.01
INFO = DatasetInfo(
    frequency=1 / PERIOD,
    features=(
        Feature(key="observation/joints", shape=(1,), dtype="float64"),
        Feature(key=RGB, shape=(48, 64, 3), dtype="uint8", encoding="jpeg"),
        Feature(key="action/joints", shape=(1,), dtype="float64"),
        Feature(key="executed/joints", shape=(1,), dtype="float64"),
        Feature(key="reward", shape=(), dtype="float64"),
        Feature(key="terminated", shape=(), dtype="bool"),
        Feature(key="truncated", shape=(), dtype="bool"),
        Feature(key="time/monotonic", shape=(), dtype="float64"),
        Feature(key="time/period", shape=(), dtype="float64"),
        Feature(key="time/command", shape=(), dtype="float64"),
        Feature(key="time/frames/wrist", shape=(), dtype="float64"),
        Feature(key="flags/frames/wrist", shape=(), dtype="uint8"),
    ),
    setup={"mode": "realtime"},
    instruction="look",
)


class Loop:
    """A loop of 100 Hz, by its stamps, with a camera of 30 Hz."""

    def __init__(self, path: Path, **settings: Any) -> None:
        self.path = path
        self.writer = DatasetWriter.open(path, INFO)
        self.recorder = Recorder(self.writer, **settings)
        self.recorder.name_next("a")
        self._rng = np.random.default_rng(0)
        self._frame = self._rng.integers(20, 236, (48, 64, 3), np.uint8)
        self._captured = -1.0

    def capture(self, now: float) -> tuple[Any, float]:
        """Give the camera's last frame and when it was taken."""
        captured = int(now * 30 + 1e-9) / 30
        if captured != self._captured:
            self._captured, self._frame = captured, self._rng.integers(20, 236, (48, 64, 3), np.uint8)
        return self._frame, captured

    def run(self, first: int, last: int, capture: Any = None) -> None:
        """Take steps; the camera may be another one."""
        for i in range(first, last):
            now = i * PERIOD
            frame, captured = (capture or self.capture)(now)
            joints = np.array([np.sin(now)])
            moved = None if i == 0 else {"joints": joints}
            step = Transition(
                observation={"joints": joints, "frames": {"wrist": {"rgb": frame}}},
                action=moved,
                executed=moved,
                reward=0.0,
                terminated=False,
                truncated=False,
                info={},
                time=now,
                capture_times={"frames/wrist": captured},
            )
            if i == 0:
                self.recorder.on_reset(step, 1)
            else:
                self.recorder.on_step(step)

    def finish(self) -> Any:
        """Complete the episode and close the dataset."""
        episode = self.recorder.finish(True)
        self.writer.close()
        return episode


class Gate:
    """Keeps a method from being called until it is opened; a loop that waits for the call stands still."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, owner: type, name: str) -> None:
        self.open = threading.Event()
        method = getattr(owner, name)

        def wait(*given: Any) -> Any:
            assert self.open.wait(60)
            return method(*given)

        monkeypatch.setattr(owner, name, wait)


def kinds(path: Path) -> list[str]:
    return [finding.kind for finding in check(path).findings if finding.kind != "time_backwards"]


def test_9_a_camera_slower_than_the_loop_is_repeated_with_flags_and_true_stamps(tmp_path: Path) -> None:
    loop = Loop(tmp_path)
    loop.run(0, 200)
    episode = loop.finish()
    stamps = episode.column("time/frames/wrist")
    is_new = np.diff(stamps, prepend=-1) > 0
    assert is_new.sum() == 60
    np.testing.assert_array_equal(episode.flags("wrist"), np.where(is_new, 0, FrameFlag.REPEATED))
    assert (stamps <= episode.column("time/monotonic") + 1e-9).all()
    assert kinds(tmp_path) == []


def test_10_a_camera_that_stalls_is_flagged_and_the_loop_does_not_feel_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate(monkeypatch, EpisodeWriter, "add")
    loop = Loop(tmp_path, background=True, stale_after=0.1)
    loop.run(0, 100)
    frozen = loop.capture(0.99)
    loop.run(100, 300, lambda _: frozen)
    loop.run(300, 400)
    gate.open.set()
    episode = loop.finish()
    stale = np.flatnonzero(episode.flags("wrist") & FrameFlag.STALE)
    assert (stale[0], stale[-1]) == (107, 299)
    assert kinds(tmp_path) == ["stale", "frozen"]


def test_10_a_camera_without_an_image_is_flagged_as_missing(tmp_path: Path) -> None:
    loop = Loop(tmp_path)
    loop.run(0, 50)
    loop.run(50, 60, lambda now: (None, now))
    loop.run(60, 80)
    episode = loop.finish()
    missing = np.flatnonzero(episode.flags("wrist") & FrameFlag.MISSING)
    np.testing.assert_array_equal(missing, np.arange(50, 60))
    assert kinds(tmp_path) == ["missing_frames"]


@pytest.mark.parametrize("background", [False, True], ids=["here", "background"])
def test_10_an_image_of_another_shape_is_refused_and_the_rows_before_it_stay(tmp_path: Path, background: bool) -> None:
    loop = Loop(tmp_path, background=background)
    loop.run(0, 50)
    with pytest.raises(InvalidSetup, match=r"rgb' is \(8, 8, 3\) uint8; expected \(48, 64, 3\)"):
        loop.run(50, 51, lambda now: (np.zeros((8, 8, 3), np.uint8), now))
    loop.run(50, 60)
    assert loop.finish().length == 60
    assert check(tmp_path).is_ok


def test_10_a_camera_that_raises_ends_the_loop_and_the_rows_before_it_stay(tmp_path: Path) -> None:
    def fail(_: float) -> Any:
        raise DeviceFault("the cable is out")

    loop = Loop(tmp_path, background=True)
    loop.run(0, 50)
    with pytest.raises(DeviceFault, match="cable"), loop.writer:
        loop.run(50, 51, fail)
    (episode,) = Dataset.open(tmp_path).episodes
    assert (episode.length, episode.success, episode.outcome["end"]) == (50, None, "closed")
    assert check(tmp_path).is_ok


def test_11_a_writer_that_is_too_slow_leaves_out_images_counts_them_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    gate = Gate(monkeypatch, EpisodeWriter, "add")
    settings = {**(BackgroundEpisode.__init__.__kwdefaults__ or {}), "bound_bytes": 200_000}
    monkeypatch.setattr(BackgroundEpisode.__init__, "__kwdefaults__", settings)
    loop = Loop(tmp_path, background=True)
    with caplog.at_level(logging.WARNING):
        loop.run(0, 200)
    gate.open.set()
    episode = loop.finish()
    dropped = episode.timing["writer"]["dropped_images"]
    # 200 kB are 21 images of 48 x 64, or more as soon as they are encoded; the camera gave 60.
    assert 10 < dropped <= 60 - 21
    assert episode.length == 200, "rows go on"
    flags = episode.flags("wrist")
    assert np.count_nonzero(flags & (FrameFlag.DROPPED | FrameFlag.REPEATED) == FrameFlag.DROPPED) == dropped
    assert np.count_nonzero(flags == 0) == 60 - dropped
    assert "slower than the loop" in caplog.text
    assert "dropped_frames" in kinds(tmp_path)
