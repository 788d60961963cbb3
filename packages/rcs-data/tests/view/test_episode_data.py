"""Curves are those of the episode to what the eye can see, and marks are where the flaws are."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rcs_data import Dataset, DatasetInfo, DatasetWriter, EpisodeRecord, Feature
from rcs_data.files.flags import FrameFlag
from rcs_data.view.episode_data import curves, episode_data, rounded

IMAGE = Feature(key="observation/frames/a/rgb", shape=(8, 8, 3), dtype="uint8", encoding="jpeg")
TIME = Feature(key="time/monotonic", shape=(), dtype="float64", unit="s")
CAPTURE = Feature(key="time/frames/a", shape=(), dtype="float64", unit="s")
FLAGS = Feature(key="flags/frames/a", shape=(), dtype="uint8")


def record(path: Path, features: tuple[Feature, ...], rows: list[dict[str, object]], **info: object) -> EpisodeRecord:
    values = {"frequency": 30.0, "features": features, "setup": {}, "instruction": "", **info}
    with DatasetWriter.open(path, DatasetInfo(**values)) as writer:  # pyright: ignore[reportArgumentType]
        episode = writer.episode("a", seed=0)
        for row in rows:
            state = np.zeros(2) if writer.info.sim_state_size else None
            episode.add(row, state)  # pyright: ignore[reportArgumentType]
        return episode.finish(None)


def marks(episode: EpisodeRecord) -> dict[tuple[str, str], list[list[int]]]:
    return {(mark["at"], mark["flaw"]): mark["runs"] for mark in episode_data(episode)["marks"]}


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False, width=32), min_size=1, max_size=20))
def test_rounding_changes_no_number_by_more_than_the_eye_sees(numbers: list[float]) -> None:
    spread = max(numbers) - min(numbers)
    visible = max(spread, 1e-3 * max(map(abs, numbers)), 1e-12)
    for number, kept in zip(numbers, rounded(np.array(numbers, np.float64)), strict=True):
        assert kept is not None
        assert abs(number - kept) <= 1e-3 * visible


def test_what_is_no_number_is_a_gap() -> None:
    assert rounded(np.array([np.nan, 1.0, np.inf])) == [None, 1, None]
    assert rounded(np.array([np.nan])) == [None]


def test_the_curves_are_the_columns_of_the_episode(filmed: Path) -> None:
    episode = Dataset.open(filmed)["000000"]
    data = episode_data(episode)
    assert data["rows"] == 40
    plots = curves(episode.info)
    assert [plot.key for plot in plots] == ["observation/joints", "action/joints", "reward", "period"]
    for plot, lines in zip(plots[:3], data["curves"], strict=False):
        shown = np.array(lines, np.float64).T.reshape(episode.column(plot.key).shape)
        np.testing.assert_allclose(shown, episode.column(plot.key), atol=1e-3)
    assert data["curves"][1][0][0] is None  # nothing was done before the reset
    (period,) = data["curves"][3]
    assert period[0] is None
    assert period[10] == pytest.approx(100, abs=0.1)


def test_two_robots_have_their_plots_one_after_the_other_and_what_belongs_together_is() -> None:
    sources, names = ("observation", "action", "executed"), ("gripper", "joints", "tquat")
    keys = ["/".join(words) for words in itertools.product(sources, ("left", "right"), names)]
    features = tuple(Feature(key=key, shape=(2,), dtype="float64") for key in keys)
    found = curves(DatasetInfo(frequency=30, features=features, setup={}, instruction=""))
    assert [plot.key for plot in found[:6]] == [
        "observation/left/joints", "action/left/joints", "executed/left/joints",
        "observation/left/gripper", "action/left/gripper", "executed/left/gripper",
    ]  # fmt: skip
    assert len(found) == len(keys)
    assert [plot.key for plot in found if not plot.is_shown] == ["observation/left/tquat", "observation/right/tquat"]


def test_pictures_matrices_and_measured_times_are_no_curves() -> None:
    features = (
        IMAGE, TIME, CAPTURE, FLAGS,
        Feature(key="observation/frames/a/extrinsics", shape=(4, 4), dtype="float64"),
        Feature(key="observation/cloud", shape=(100, 3), dtype="float32"),
        Feature(key="simulated_time", shape=(), dtype="float64"),
        Feature(key="terminated", shape=(), dtype="bool"),
    )  # fmt: skip
    found = curves(DatasetInfo(frequency=30, features=features, setup={}, instruction=""))
    assert [plot.key for plot in found] == ["period", "terminated"]


def test_flags_of_a_camera_are_marked_in_runs(tmp_path: Path) -> None:
    flags = [0, 1, 1, 0, 2, 3, 0, 4, 8, 8]
    rows: list[dict[str, object]] = [
        {FLAGS.key: np.uint8(flag), IMAGE.key: np.full((8, 8, 3), 20 * i, np.uint8)} for i, flag in enumerate(flags)
    ]
    found = marks(record(tmp_path, (IMAGE, FLAGS), rows))
    assert FrameFlag.REPEATED == 1
    assert found == {
        ("a", "repeated"): [[1, 2], [5, 5]],
        ("a", "stale"): [[4, 5]],
        ("a", "missing"): [[7, 7]],
        ("a", "dropped"): [[8, 9]],
    }


def test_an_image_that_comes_twice_is_marked_without_flags(tmp_path: Path) -> None:
    shades = [0, 50, 50, 50, 100, 150, 150]
    rows: list[dict[str, object]] = [{IMAGE.key: np.full((8, 8, 3), shade, np.uint8)} for shade in shades]
    episode = record(tmp_path, (IMAGE,), rows)
    assert marks(episode) == {("a", "repeated"): [[2, 3], [6, 6]]}
    assert episode_data(episode)["flaws"] == {"repeated": 3}


def test_an_image_of_the_same_time_is_marked(tmp_path: Path) -> None:
    stamps = [1.0, 1.1, 1.1, 1.4]
    rows: list[dict[str, object]] = [
        {IMAGE.key: np.full((8, 8, 3), 20 * i, np.uint8), CAPTURE.key: stamp} for i, stamp in enumerate(stamps)
    ]
    assert marks(record(tmp_path, (IMAGE, CAPTURE), rows)) == {("a", "repeated"): [[2, 2]]}


def test_late_early_and_backward_steps_are_told_apart(tmp_path: Path) -> None:
    periods = np.array([1, 1, 1.19, 1.3, 0.7, 1.6, 3.0, 1, -1, 1]) / 30
    rows: list[dict[str, object]] = [{TIME.key: time} for time in 50 + np.cumsum([0, *periods])]
    assert marks(record(tmp_path, (TIME,), rows)) == {
        ("loop", "jitter"): [[4, 5]],
        ("loop", "gap"): [[6, 7]],
        ("loop", "backwards"): [[9, 9]],
    }


def test_a_simulation_that_does_not_wait_has_no_late_steps(tmp_path: Path) -> None:
    rows: list[dict[str, object]] = [{TIME.key: time} for time in 50 + np.cumsum([0.001, 0.002, 0.4, 0.001])]
    for stepping, expected in (("async", set()), ("realtime", {("loop", "gap"), ("loop", "jitter")})):
        episode = record(tmp_path / stepping, (TIME,), rows, setup={"stepping": stepping}, sim_state_size=2)
        assert set(marks(episode)) == expected


def test_an_episode_of_one_row_has_curves_and_no_marks(tmp_path: Path) -> None:
    data = episode_data(record(tmp_path, (TIME, IMAGE), [{TIME.key: 1.0, IMAGE.key: np.zeros((8, 8, 3), np.uint8)}]))
    assert data == {"rows": 1, "stride": 1, "curves": [[[None]]], "marks": [], "flaws": {}}
