"""Cameras in environments: how often they have a new frame, and what is recorded of the others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcs_data import DatasetWriter
from rcs_data.files.flags import FrameFlag

import rcs
from rcs.envs.observers.dataset_info import dataset_info
from rcs.envs.observers.recorder import Recorder
from rcs.envs.ports.simulated import SimCameraPort
from rcs.testing.env_contract import require_same_bits

pytestmark = pytest.mark.gl


def nudge(env: Any) -> dict[str, Any]:
    """Return an action that moves the arm a little at every step."""
    action = {key: np.zeros(space.shape, space.dtype) for key, space in env.action_space.spaces.items()}
    action["joints"][..., 0] = 0.002
    return action


def frames(env: Any, steps: int, seed: int) -> list[dict[str, Any]]:
    observation, _ = env.reset(seed=seed)
    seen = [observation["frames"]]
    for _ in range(steps):
        observation, *_ = env.step(nudge(env))
        seen.append(observation["frames"])
    return seen


def changes(seen: list[dict[str, Any]], camera: str) -> list[int]:
    """Return the steps at which a camera showed something new. The arm moves, so a new frame differs."""
    return [i for i in range(1, len(seen)) if not np.array_equal(seen[i][camera]["rgb"], seen[i - 1][camera]["rgb"])]


def test_by_default_a_frame_at_control_rate_shows_the_present_state() -> None:
    env = rcs.make("PickCuboid", cameras=rcs.Cameras(names=("wrist", "side"), image_size=(48, 32)))
    (port,) = (port for port in env.stack.ports if isinstance(port, SimCameraPort))
    observation, _ = env.reset(seed=0)
    for _ in range(5):
        require_same_bits(observation["frames"], port.cameras.read())
        observation, *_ = env.step(nudge(env))
    env.close()


def test_each_camera_has_its_own_rate_beside_a_hundred_control_steps() -> None:
    env = rcs.make(
        "PickCuboid",
        cameras=rcs.Cameras(names=("wrist", "side"), image_size=64, fps={"wrist": 30, "side": 15}),
        frequency=100,
    )
    seen = frames(env, 41, seed=0)
    assert changes(seen, "wrist") == [4, 7, 10, 14, 17, 20, 24, 27, 30, 34, 37, 40]
    assert changes(seen, "side") == [7, 14, 20, 27, 34, 40]
    env.close()


@pytest.mark.parametrize(
    "options",
    [
        {
            "robot": "fr3",
            "cameras": rcs.Cameras(names=("wrist", "side"), image_size=48, fps={"wrist": 30, "side": 15}),
            "frequency": 50,
        },
        {"robot": "so101", "cameras": rcs.Cameras(names=("wrist", "diagonal"), image_size=48)},
        {
            "robot": "so101",
            "cameras": rcs.Cameras(names=("wrist",), image_size=48, noise=True),
            "frequency": 60,
            "randomisation": True,
        },
    ],
    ids=["fr3", "so101", "so101 varied"],
)
def test_a_copy_sees_what_a_single_environment_sees(options: dict[str, Any]) -> None:
    copies, steps = 2, 12
    envs = rcs.make_vec("PickCuboid", copies=copies, max_episode_steps=7, **options)
    batch = frames(envs, steps, seed=4)
    envs.close()
    for copy in range(copies):
        env = rcs.make("PickCuboid", max_episode_steps=7, **options)
        seen = frames(env, 7, seed=4 + copy)
        observation, _ = env.reset()
        seen.append(observation["frames"])
        for _ in range(steps - 8):
            seen.append(env.step(nudge(env))[0]["frames"])
        for whole, one in zip(batch, seen, strict=True):
            mine = {name: {key: value[copy] for key, value in frame.items()} for name, frame in whole.items()}
            require_same_bits(mine, one)
        env.close()


def test_the_rate_of_a_webcam_rolls_by_the_seed() -> None:
    env = rcs.make("PickCuboid", robot="so101", cameras=rcs.Cameras(names=("wrist",), image_size=48), frequency=100)
    taken: list[list[int]] = []
    for seed in (0, 0, 1):
        env.reset(seed=seed)
        times = [env.stack.capture_times()["frames/wrist"]]
        for _ in range(100):
            env.step(nudge(env))
            times.append(env.stack.capture_times()["frames/wrist"])
        taken.append(np.flatnonzero(np.diff(times)).tolist())
    assert taken[0] == taken[1]
    assert taken[0] != taken[2]
    # 33 to 40 ms are 3 or 4 steps, and more of the latter.
    assert set(np.diff(taken[0])) == {3, 4}
    assert 25 <= len(taken[0]) <= 30
    env.close()


def test_a_recorded_frame_that_came_again_keeps_its_time_and_is_flagged(tmp_path: Path) -> None:
    setup = rcs.Setup(
        task="PickCuboid", cameras=rcs.Cameras(names=("wrist",), image_size=(48, 48), fps=30), frequency=100
    )
    env = rcs.make(setup)
    with DatasetWriter.open(tmp_path / "dataset", dataset_info(env, colour="lossless")) as writer:
        recorder = Recorder(writer)
        env.add_observer(recorder)
        recorder.name_next("one")
        seen = frames(env, 20, seed=0)
        episode = recorder.finish(success=None)
        is_new = [0, *changes(seen, "wrist")]
        assert is_new == [0, 4, 7, 10, 14, 17, 20]
        repeated = (episode.column("flags/frames/wrist") & FrameFlag.REPEATED).astype(bool)
        np.testing.assert_array_equal(np.flatnonzero(~repeated), is_new)
        times = episode.column("time/frames/wrist")
        np.testing.assert_array_equal(np.flatnonzero(np.diff(times, prepend=-1.0)), is_new)
        for image, given in zip(episode.frames("observation/frames/wrist/rgb"), seen, strict=True):
            np.testing.assert_array_equal(image, given["wrist"]["rgb"])
        camera = episode.about["timing"]["cameras"]["observation/frames/wrist/rgb"]
        assert (camera["new_images"], camera["repeated"], camera["stale"]) == (7, 14, 0)
    env.close()
