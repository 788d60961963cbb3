"""Cameras of one setup may have frames of different sizes, simulated and real, alone and in copies."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset

import rcs
from rcs.devices import CameraMode
from rcs.devices.fakes import FakeCamera
from rcs.errors import InvalidSetup

CAMERAS = rcs.Cameras(names=("wrist", "side"), image_size={"wrist": (40, 30), "side": (64, 48)})
STAY = {"joints": np.zeros(7), "gripper": np.ones(1)}


def shapes(frames: dict[str, Any], key: str = "rgb") -> dict[str, tuple[int, ...]]:
    return {name: frame[key].shape for name, frame in frames.items()}


@pytest.mark.gl
@pytest.mark.parametrize("stepping", ["async", "realtime"])
def test_each_simulated_camera_has_its_size_and_sees_as_it_does_alone(stepping: Any) -> None:
    with rcs.make("PickCuboid", stepping=stepping, cameras=replace(CAMERAS, depth=True)) as env:
        observation, _ = env.reset(seed=0)
        assert env.observation_space.contains(observation)
        assert shapes(observation["frames"]) == {"wrist": (30, 40, 3), "side": (48, 64, 3)}
        assert shapes(observation["frames"], "depth") == {"wrist": (30, 40), "side": (48, 64)}
    with rcs.make("PickCuboid", cameras=rcs.Cameras(names=("wrist", "side"), image_size=(64, 48))) as env:
        alone, _ = env.reset(seed=0)
    for key in ("rgb", "intrinsics", "extrinsics"):
        np.testing.assert_array_equal(observation["frames"]["side"][key], alone["frames"]["side"][key])


@pytest.mark.gl
def test_copies_have_the_frames_of_a_single_environment() -> None:
    with rcs.make("PickCuboid", cameras=CAMERAS) as env:
        single, _ = env.reset(seed=3)
    envs = rcs.make_vec("PickCuboid", copies=2, threads=1, cameras=CAMERAS)
    observations, _ = envs.reset(seed=[3, 4])
    envs.close()
    for name in CAMERAS.names:
        np.testing.assert_array_equal(observations["frames"][name]["rgb"][0], single["frames"][name]["rgb"])


def test_real_cameras_of_different_sizes_are_recorded(tmp_path: Any) -> None:
    modes = {"wrist": CameraMode(848, 480, 30.0, False), "side": CameraMode(640, 480, 30.0, False)}
    hardware = {"fr3": "fake:a", **{name: FakeCamera(mode, name=name) for name, mode in modes.items()}}
    with rcs.make("Free", hardware=hardware, frequency=50, cameras=CAMERAS) as env:
        assert not env.is_simulated
        with rcs.record(env, tmp_path / "takes") as takes:
            takes.start("look", at_reset=True)
            env.reset(seed=0)
            for _ in range(3):
                env.step(STAY)
            takes.finish(None)
    dataset = Dataset.open(tmp_path / "takes")
    features = {one.key: one.shape for one in dataset.info.features}
    assert features["observation/frames/wrist/rgb"] == (30, 40, 3)
    assert features["observation/frames/side/rgb"] == (48, 64, 3)
    assert rcs.Setup.from_json(dataset.info.setup).cameras.size_of("side") == (64, 48)


def test_pixels_for_learners_are_of_one_size() -> None:
    with pytest.raises(InvalidSetup, match="of one size"):
        replace(CAMERAS, pixels=True)
