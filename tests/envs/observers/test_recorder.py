from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rcs_data import DatasetInfo, DatasetWriter, Feature
from rcs_data.files.flags import FrameFlag

import rcs
from rcs.envs.observer import Transition
from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.observers.recorder import Recorder

RGB = "observation/frames/wrist/rgb"
INFO = DatasetInfo(
    frequency=100.0,
    features=(
        Feature(key="observation/joints", shape=(1,), dtype="float64"),
        Feature(key=RGB, shape=(8, 8, 3), dtype="uint8", encoding="lossless"),
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
    setup={},
    instruction="wait",
)


def transition(i: int, captured: float, *, time: float | None = None, is_first: bool = False) -> Transition:
    """Row i at 100 Hz, with a frame that was captured at a given time and shows it."""
    joints = np.array([float(i)])
    frame = np.full((8, 8, 3), round(1000 * captured) % 251, np.uint8)
    return Transition(
        observation={"joints": joints, "frames": {"wrist": {"rgb": frame}}},
        action=None if is_first else {"joints": joints},
        executed=None if is_first else {"joints": joints},
        reward=0.0,
        terminated=False,
        truncated=False,
        info={},
        time=i / 100 if time is None else time,
        capture_times={"frames/wrist": captured},
    )


def env() -> Any:
    return SimpleNamespace(is_simulated=False)


@pytest.fixture(params=[False, True], ids=["here", "background"])
def recorder(request: pytest.FixtureRequest, tmp_path: Path) -> Any:
    with DatasetWriter.open(tmp_path, INFO) as writer:
        yield Recorder(writer, background=request.param, stale_after=0.1)


def capture_time(i: int) -> float:
    """When a 30 Hz camera took the frame that a 100 Hz loop sees in row i."""
    return int(i / 100 * 30 + 1e-9) / 30


def test_of_a_camera_slower_than_the_loop_each_frame_is_stored_once_and_repeats_are_flagged(recorder: Any) -> None:
    recorder.name_next("a")
    recorder.on_reset(transition(0, 0.0, is_first=True), 1)
    for i in range(1, 100):
        recorder.on_step(transition(i, capture_time(i)))
    episode = recorder.finish(True)
    is_new = np.diff([capture_time(i) for i in range(100)], prepend=-1) != 0
    assert is_new.sum() == 30
    np.testing.assert_array_equal(episode.flags("wrist"), np.where(is_new, 0, FrameFlag.REPEATED))
    assert (np.diff(episode.image_numbers([RGB])[RGB]) == 0).sum() == 70
    shown = [round(1000 * capture_time(i)) % 251 for i in range(100)]
    np.testing.assert_array_equal(episode.column(RGB)[:, 0, 0, 0], shown)
    np.testing.assert_array_equal(episode.column("time/frames/wrist"), [capture_time(i) for i in range(100)])


def test_a_camera_that_stalls_is_flagged_as_stale(recorder: Any) -> None:
    recorder.name_next("a")
    recorder.on_reset(transition(0, 0.0, is_first=True), None)
    for i in range(1, 31):
        recorder.on_step(transition(i, min(capture_time(i), 0.1)))
    flags = recorder.finish(None).flags("wrist")
    stale = (flags & FrameFlag.STALE).astype(bool)
    np.testing.assert_array_equal(np.flatnonzero(stale), np.arange(21, 31))


def test_a_device_without_a_clock_has_no_time_of_its_own(tmp_path: Path) -> None:
    info = replace(INFO, features=(*INFO.features, Feature(key="time/device/joints", shape=(), dtype="float64")))
    with DatasetWriter.open(tmp_path, info) as writer:
        recorder = Recorder(writer)
        recorder.name_next("a")
        for i, at in enumerate((np.nan, 7.0, np.nan)):
            row = replace(transition(i, capture_time(i), is_first=i == 0), device_times={"joints": at})
            recorder.on_step(row) if i else recorder.on_reset(row, None)
        np.testing.assert_array_equal(recorder.finish(True).column("time/device/joints"), [np.nan, 7.0, np.nan])


def test_an_action_may_come_as_a_plain_number_or_a_list(recorder: Any) -> None:
    recorder.name_next("a")
    recorder.on_reset(transition(0, 0.0, is_first=True), None)
    given: list[Any] = [0.5, [0.25]]
    for i, joints in enumerate(given, 1):
        recorder.on_step(replace(transition(i, i / 100), action={"joints": joints}))
    np.testing.assert_array_equal(recorder.finish(None).column("action/joints")[1:, 0], [0.5, 0.25])


def test_an_episode_can_begin_in_the_middle_of_a_run(recorder: Any) -> None:
    recorder.on_reset(transition(0, 0.0, is_first=True), None)
    recorder.on_step(transition(1, 0.01))
    recorder.name_next("a", instruction="go", at_reset=False)
    for i in range(2, 6):
        recorder.on_step(transition(i, i / 100))
    episode = recorder.finish(True)
    assert (episode.length, episode.instruction) == (4, "go")
    np.testing.assert_array_equal(episode.column("action/joints")[:, 0], [np.nan, 3, 4, 5])
    assert episode.flags("wrist").tolist() == [0, 0, 0, 0]


@pytest.mark.gl
def test_the_matrices_of_cameras_are_held_and_those_of_a_wrist_change(tmp_path: Path) -> None:
    setup_env = rcs.make("PickCuboid", robot="fr3", cameras=rcs.Cameras(names=("wrist", "side"), image_size=64))
    info = dataset_info(setup_env)
    with DatasetWriter.open(tmp_path, info) as writer:
        recorder = Recorder(writer)
        setup_env.add_observer(recorder)
        recorder.name_next("a")
        setup_env.reset(seed=1)
        for _ in range(5):
            action = setup_env.action_space.sample()
            setup_env.step(action)
        episode = recorder.finish(None)
    matrices = (f"observation/frames/{c}/{m}" for c in ("wrist", "side") for m in ("intrinsics", "extrinsics"))
    different = {key: len(np.unique(episode.column(key), axis=0)) for key in matrices}
    assert all(info.feature(key).encoding == "held" for key in different)
    assert different["observation/frames/side/extrinsics"] == different["observation/frames/side/intrinsics"] == 1
    assert different["observation/frames/wrist/intrinsics"] == 1
    assert different["observation/frames/wrist/extrinsics"] > 1
    setup_env.close()


def test_where_the_objects_were_at_the_start_is_kept_with_the_episode(tmp_path: Path) -> None:
    setup_env = rcs.make("PickCuboid", robot="fr3")
    with DatasetWriter.open(tmp_path, dataset_info(setup_env)) as writer:
        recorder = Recorder(writer)
        setup_env.add_observer(recorder)
        recorder.name_next("a")
        _, info = setup_env.reset(seed=1)
        for _ in range(3):
            setup_env.step(setup_env.action_space.sample())
        episode = recorder.finish(None, {"failure": "slip"})
    assert episode.outcome["failure"] == "slip"
    np.testing.assert_array_equal(episode.outcome["objects"]["cuboid"], info["cuboid"])
