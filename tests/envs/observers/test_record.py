"""Recording with one call: takes of a person, and every episode of one environment or of all copies of a batch."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset, DatasetWriter

import rcs
from rcs.devices import CameraMode
from rcs.devices.fakes import FakeCamera
from rcs.envs.env import Env
from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.observers.record import record, record_all
from rcs.envs.observers.recorder import Recorder
from rcs.errors import DatasetError
from rcs.sim.pixels import Pixels

COPIES = 24
OPTIONS = {"task": "PickCuboid", "max_episode_steps": 6}


def actions_of(env: Env, seed: int, steps: int) -> list[dict[str, np.ndarray]]:
    """Return actions that depend on the seed alone."""
    random = np.random.default_rng(seed)
    low, high = env.action_space["joints"].low, env.action_space["joints"].high
    return [
        {"joints": random.uniform(low, high), "gripper": random.uniform(0.0, 1.0, 1).astype(np.float32)}
        for _ in range(steps)
    ]


def test_copies_recorded_together_are_the_episodes_that_single_environments_record(tmp_path: Path) -> None:
    single = rcs.make(**OPTIONS)
    given = [actions_of(single, seed, 6) for seed in range(COPIES)]
    with record_all(single, tmp_path / "alone"):
        for seed in range(COPIES):
            single.reset(seed=seed)
            for action in given[seed]:
                single.step(action)
    envs = rcs.make_vec(**OPTIONS, copies=COPIES, autoreset="Disabled")
    with record_all(envs, tmp_path / "together"):
        envs.reset(seed=0)
        for step in range(6):
            envs.step({key: np.stack([given[copy][step][key] for copy in range(COPIES)]) for key in given[0][0]})
    alone, together = Dataset.open(tmp_path / "alone"), Dataset.open(tmp_path / "together")
    assert len(alone) == len(together) == COPIES
    of_seed = {episode.seed: episode for episode in together}
    for episode in alone:
        other = of_seed[episode.seed]
        assert (episode.length, episode.success) == (other.length, other.success) == (7, False)
        np.testing.assert_array_equal(episode.sim_state(), other.sim_state())
        for key in ("observation/tquat", "executed/joints", "reward", "truncated", "simulated_time"):
            np.testing.assert_array_equal(episode.column(key), other.column(key), err_msg=key)


@pytest.mark.gl
def test_copies_that_start_anew_by_themselves_go_on_in_new_episodes_with_their_own_frames(tmp_path: Path) -> None:
    envs = rcs.make_vec(**OPTIONS, copies=3, cameras=rcs.Cameras(names=("side",), image_size=16))
    frames: list[np.ndarray] = []
    with record_all(envs, tmp_path / "set", colour="lossless"):
        frames.append(envs.reset(seed=0)[0]["frames"]["side"]["rgb"].copy())
        for _ in range(15):  # two whole episodes of each copy, and a step for each start
            frames.append(envs.step(envs.action_space.sample())[0]["frames"]["side"]["rgb"].copy())
    dataset = Dataset.open(tmp_path / "set")
    whole = [episode for episode in dataset if episode.length == 7]
    assert len(whole) == 6
    first = {int(episode.seed or 0): episode for episode in whole if episode.id in ("000000", "000001", "000002")}
    assert sorted(first) == [0, 1, 2]
    for seed, episode in first.items():
        seen = list(episode.frames("observation/frames/side/rgb"))
        np.testing.assert_array_equal(seen, [frame[seed] for frame in frames[:7]])


def test_a_second_recording_goes_on_with_new_names(tmp_path: Path) -> None:
    for _ in range(2):
        env = rcs.make(**OPTIONS)
        with record_all(env, tmp_path / "set"):
            env.reset(seed=0)
            for action in actions_of(env, 0, 6):
                env.step(action)
        env.close()
    assert [episode.id for episode in Dataset.open(tmp_path / "set")] == ["000000", "000001"]


def test_an_episode_that_is_open_in_the_end_is_kept_without_a_verdict_and_nothing_more_is_recorded(
    tmp_path: Path,
) -> None:
    env = rcs.make(**OPTIONS)
    with record_all(env, tmp_path / "set"):
        env.reset(seed=0)
        env.step(env.action_space.sample())
    env.step(env.action_space.sample())
    env.reset(seed=1)
    [episode] = Dataset.open(tmp_path / "set")
    assert (episode.length, episode.success) == (2, None)


def test_an_episode_that_a_reset_cuts_short_is_not_kept_and_a_loop_in_real_time_is_recorded_beside_it(
    tmp_path: Path,
) -> None:
    env = rcs.make("Free", hardware="fake", max_episode_steps=3)
    with record_all(env, tmp_path / "set", notes=["latency"]):
        for steps in (1, 3):
            env.reset()
            for _ in range(steps):
                env.note(latency=0.25)
                env.step(env.action_space.sample())
    [episode] = Dataset.open(tmp_path / "set")
    assert (episode.length, episode.success) == (4, None)
    np.testing.assert_array_equal(episode.column("notes/latency")[1:], [0.25] * 3)
    assert Dataset.open(tmp_path / "set").info.origin["platform"] == {"fr3": "fake", "fr3/franka_hand": "fake"}
    env.close()


class NumberedCamera(FakeCamera):
    """Knows its serial number once it is open."""

    @property
    def about(self) -> dict[str, Any]:
        return {"serial": "A1" if self.is_open else "", "options": {"gain": 3}}


def test_what_a_camera_says_once_it_is_open_is_in_each_episode_and_its_dataset_can_be_continued(
    tmp_path: Path,
) -> None:
    camera = NumberedCamera(CameraMode(640, 480, 30.0, False), name="side")
    with rcs.make("Free", cameras=("side",), hardware={"fr3": "fake", "side": camera}) as env:
        for _ in range(2):
            with record(env, tmp_path / "set") as takes:
                takes.start(at_reset=True)
                env.reset()
                takes.finish(success=None)
    dataset = Dataset.open(tmp_path / "set")
    about = dataset.info.origin["cameras"]["side"]
    assert (about["options"], about["source"]) == ({"gain": 3}, "calibration")
    assert [episode.outcome["cameras"] for episode in dataset] == [{"side": {"serial": "A1"}}] * 2


def test_takes_are_kept_discarded_and_done_again_by_a_person(tmp_path: Path) -> None:
    env = rcs.make(**OPTIONS)
    with record(env, tmp_path / "set", notes=["intervention"]) as takes:
        for verdict in (True, None, False):
            takes.start("lift it", at_reset=True)
            env.reset(seed=0)
            env.note(intervention=1.0)
            env.step(env.action_space.sample())
            takes.discard() if verdict is None else takes.finish(success=verdict)
    episodes = list(Dataset.open(tmp_path / "set"))
    assert [(episode.id, episode.success) for episode in episodes] == [("000000", True), ("000001", False)]
    assert episodes[0].instruction == "lift it"
    np.testing.assert_array_equal(episodes[0].column("notes/intervention"), [np.nan, 1.0])


def test_what_cannot_be_recorded_leaves_the_environment_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    env = rcs.make(**OPTIONS)
    with pytest.raises(DatasetError, match="file"), record_all(env, tmp_path / "file"):
        pass
    env.reset(seed=0)
    env.step(env.action_space.sample())


@pytest.mark.parametrize("background", [False, True], ids=["here", "background"])
def test_pixels_for_learners_are_recorded_as_they_were_though_their_memory_is_used_again(
    background: bool, tmp_path: Path
) -> None:
    pixels = Pixels(stack=2, valid_steps=1)
    env = rcs.make("PickCuboid", cameras=rcs.Cameras(names=("side",), image_size=(16, 16), pixels=pixels))
    env.action_space.seed(0)
    with DatasetWriter.open(tmp_path, dataset_info(env)) as writer:
        recorder = Recorder(writer, background=background)
        env.add_observer(recorder)
        recorder.start(at_reset=True)
        seen = [env.reset(seed=0)[0]["frames"]["side"]["pixels"].copy()]
        for _ in range(12):
            seen.append(env.step(env.action_space.sample())[0]["frames"]["side"]["pixels"].copy())
        recorder.finish(success=None)
        recorder.close()
    env.close()
    (episode,) = Dataset.open(tmp_path)
    np.testing.assert_array_equal(episode.column("observation/frames/side/pixels"), seen)
    assert len({frame.tobytes() for frame in seen}) > 6
