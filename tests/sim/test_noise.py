"""Camera noise: as large as stated, the same for the same moment, and nothing nearer than the camera can see."""

from __future__ import annotations

import numpy as np
import pytest

import rcs
from rcs.robots.cameras import REALSENSE_D405, REALSENSE_D435, USB_WEBCAM
from rcs.robots.description import Mount
from rcs.sim import CameraPlacement, Scene, World
from rcs.sim.camera import SimCameras
from rcs.sim.noise import COLOUR_DEVIATION, SUBPIXEL, CameraNoise, nearest_depth
from rcs.testing.env_contract import require_same_bits

SIZE = (320, 240)
FOCAL = 300.0


def frame(depth_mm: int) -> dict[str, np.ndarray]:
    return {
        "rgb": np.full((240, 320, 3), 128, np.uint8),
        "depth": np.full((240, 320), depth_mm, np.uint16),
        "intrinsics": np.array([[FOCAL, 0.0, 159.5], [0.0, FOCAL, 119.5], [0.0, 0.0, 1.0]]),
    }


def test_the_noise_has_the_deviation_that_is_stated() -> None:
    noise = CameraNoise(REALSENSE_D435, SIZE, "wrist")
    noisy = noise.add(frame(2000), np.arange(5.0))
    assert noisy["rgb"].std() == pytest.approx(COLOUR_DEVIATION, rel=0.05)
    expected = 1e3 * 2.0**2 / (FOCAL * 0.05) * SUBPIXEL
    depth = noisy["depth"][noisy["depth"] > 0]
    assert depth.size > 0.9 * noisy["depth"].size
    assert depth.std() == pytest.approx(expected, rel=0.05)
    assert depth.mean() == pytest.approx(2000.0, rel=0.001)


def test_depth_noise_grows_with_the_square_of_the_distance() -> None:
    noise = CameraNoise(REALSENSE_D435, SIZE, "wrist")
    near, far = (noise.add(frame(depth), np.zeros(3))["depth"][:, 50:].std() for depth in (1000, 3000))
    assert far / near == pytest.approx(9.0, rel=0.05)


def test_nothing_nearer_than_the_nearest_depth_is_seen_and_nothing_stays_nothing() -> None:
    nearest = nearest_depth(REALSENSE_D405, (640, 360))
    assert nearest == pytest.approx(0.055)
    noise = CameraNoise(REALSENSE_D405, (640, 360), "wrist")
    shape = {"rgb": np.full((360, 640, 3), 128, np.uint8), "intrinsics": np.diag([430.0, 430.0, 1.0])}
    assert not noise.add({**shape, "depth": np.full((360, 640), 40, np.uint16)}, np.zeros(2))["depth"].any()
    assert not noise.add({**shape, "depth": np.zeros((360, 640), np.uint16)}, np.zeros(2))["depth"].any()


def test_the_nearest_depth_is_that_of_the_smallest_format_around_a_frame() -> None:
    for width, height, depth in REALSENSE_D435.min_depth:
        assert nearest_depth(REALSENSE_D435, (width, height)) == depth
    assert nearest_depth(REALSENSE_D435, (224, 224)) == 0.105
    assert nearest_depth(REALSENSE_D435, (640, 400)) == 0.175
    assert nearest_depth(REALSENSE_D435, (1920, 1080)) == 0.28
    assert nearest_depth(USB_WEBCAM, (640, 480)) == 0.0


def test_the_argument_stays_as_it_is_and_another_moment_or_camera_has_other_noise() -> None:
    noise = CameraNoise(REALSENSE_D435, SIZE, "wrist")
    given = frame(1000)
    one = noise.add(given, np.array([0.1, 0.2]))
    assert (given["rgb"] == 128).all()
    assert (given["depth"] == 1000).all()
    require_same_bits(one, noise.add(given, np.array([0.1, 0.2])))
    assert not np.array_equal(one["rgb"], noise.add(given, np.array([0.1, 0.3]))["rgb"])
    other = CameraNoise(REALSENSE_D435, SIZE, "side").add(given, np.array([0.1, 0.2]))
    assert not np.array_equal(one["rgb"], other["rgb"])


def test_the_noise_of_a_scene_that_stands_still_is_another_in_every_frame() -> None:
    noise = CameraNoise(REALSENSE_D435, SIZE, "wrist")
    given, joints = frame(2000), np.arange(5.0)
    frames = [noise.add(given, np.array([step / 30, *joints])) for step in range(20)]
    errors = np.stack([one["rgb"].astype(float) - 128 for one in frames]).reshape(20, -1)
    correlation = np.corrcoef(errors)[np.triu_indices(20, 1)]
    assert np.abs(correlation).max() < 0.02  # a shift of one field has 1 for two frames in 4096
    mean = np.mean([one["depth"][one["depth"] > 0].mean() for one in frames])
    assert mean == pytest.approx(2000, abs=0.5)
    depth = np.stack([one["depth"].astype(float) for one in frames])[:, 60:180, 80:240]
    one_pixel = depth.std(axis=0).mean()
    assert one_pixel == pytest.approx(1e3 * 2.0**2 / (FOCAL * 0.05) * SUBPIXEL, rel=0.05), "a pixel's own error varies"


def test_a_shift_of_another_frames_noise_is_not_the_noise_of_this_one() -> None:
    noise = CameraNoise(REALSENSE_D435, SIZE, "wrist")
    one, two = (noise.add(frame(1000), np.array([time, 0.0]))["rgb"][..., 0].astype(float) - 128 for time in (0.0, 0.1))
    found = np.fft.ifft2(np.fft.fft2(one) * np.conj(np.fft.fft2(two))).real / one.size / one.var()
    assert np.abs(found).max() < 0.05


@pytest.mark.gl
def test_a_camera_has_the_same_noise_whichever_others_are_observed() -> None:
    scene = Scene.empty()
    eyes: list[CameraPlacement] = []
    for name, x in (("left", 0.2), ("right", 0.4)):
        above = Mount(translation=(x, 0.0, 1.0), quaternion=(1.0, 0.0, 0.0, 0.0))
        eyes.append(CameraPlacement(name=name, camera=USB_WEBCAM, parent_body="world", optical_in_parent=above))
        scene.add_camera(eyes[-1])
    world = World(scene.compile())
    both, one = (SimCameras(world, chosen, size=(48, 32), has_noise=True) for chosen in (eyes, eyes[1:]))
    require_same_bits(both.read()["right"], one.read()["right"])
    both.close()
    one.close()


@pytest.mark.gl
def test_a_copy_has_the_noise_of_the_single_environment() -> None:
    setup = rcs.Setup(cameras=rcs.Cameras(names=("wrist", "side"), image_size=(48, 32), depth=True, noise=True))
    single, batch = rcs.make(setup), rcs.make_vec(setup, copies=2)
    one, many = single.reset(seed=6)[0]["frames"], batch.reset(seed=5)[0]["frames"]
    require_same_bits(one, {name: {key: value[1] for key, value in part.items()} for name, part in many.items()})
    clean = rcs.make("PickCuboid", cameras=rcs.Cameras(names=("wrist",), image_size=(48, 32))).reset(seed=6)[0][
        "frames"
    ]["wrist"]["rgb"]
    assert not np.array_equal(clean, one["wrist"]["rgb"])
    single.close()
    batch.close()
