from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import rcs
from rcs.errors import InvalidSetup
from rcs.robots.cameras import REALSENSE_D435
from rcs.robots.description import Mount
from rcs.sim import CameraPlacement, RobotPlacement, Scene, World
from rcs.sim.camera import SimCameras
from rcs.sim.viewer import Picture

EYE = CameraPlacement(
    name="eye",
    camera=REALSENSE_D435,
    parent_body="world",
    # A metre above the table, looking straight down.
    optical_in_parent=Mount(translation=(0.3, 0.0, 1.0), quaternion=(1.0, 0.0, 0.0, 0.0)),
)
SIZE = (48, 32)


def scene(placement: RobotPlacement | None = None) -> Scene:
    scene = Scene.empty()
    scene.add_table()
    if placement is not None:
        scene.add_robot(placement)
    scene.add_camera(EYE)
    return scene


@pytest.fixture
def world() -> World:
    return World(scene().compile(), frequency=30.0)


@pytest.fixture
def cameras(world: World) -> Iterator[SimCameras]:
    cameras = SimCameras(world, [EYE], size=SIZE, has_depth=True)
    yield cameras
    cameras.close()


@pytest.mark.gl
def test_depth_is_the_distance_in_millimetres(cameras: SimCameras) -> None:
    depth = cameras.read()["eye"]["depth"]
    assert depth.dtype == np.uint16
    assert depth.shape == (32, 48)
    assert abs(int(depth[16, 24]) - 1000) <= 2


@pytest.mark.gl
def test_frames_are_arrays_of_their_own(cameras: SimCameras) -> None:
    first, second = cameras.read()["eye"], cameras.read()["eye"]
    for key in ("rgb", "depth"):
        np.testing.assert_array_equal(first[key], second[key])
        assert not np.shares_memory(first[key], second[key])


@pytest.mark.gl
def test_a_camera_can_be_read_again_after_it_was_closed(cameras: SimCameras) -> None:
    before = cameras.read()["eye"]["rgb"]
    cameras.close()
    cameras.close()
    np.testing.assert_array_equal(cameras.read()["eye"]["rgb"], before)


@pytest.mark.gl
def test_every_copy_has_the_picture_of_a_world_of_one(placement: RobotPlacement) -> None:
    model = scene(placement).compile()
    rng = np.random.default_rng(0)
    starts = np.array(placement.arm.home) + rng.uniform(-0.3, 0.3, (3, 7))
    joints = [model.joint(placement.prefix + name).qposadr[0] for name in placement.arm.joints]
    batch = World(model, copies=3, threads=2)
    batch.qpos[:, joints] = starts
    batch.refresh()
    pool = SimCameras(batch, [EYE], size=SIZE, has_depth=True)
    frames = pool.read()["eye"]
    assert frames["rgb"].shape == (3, 32, 48, 3)
    for copy in range(3):
        single = World(model)
        single.qpos[joints] = starts[copy]
        single.refresh()
        one = SimCameras(single, [EYE], size=SIZE, has_depth=True)
        frame = one.read()["eye"]
        np.testing.assert_array_equal(frames["rgb"][copy], frame["rgb"])
        np.testing.assert_array_equal(frames["depth"][copy], frame["depth"])
        one.close()
    assert not np.array_equal(frames["rgb"][0], frames["rgb"][1])
    pool.close()


@pytest.mark.gl
def test_reading_a_camera_changes_no_state(world: World, cameras: SimCameras) -> None:
    before = world.core.get_state(0)
    cameras.read()
    np.testing.assert_array_equal(world.core.get_state(0), before)


@pytest.mark.gl
def test_a_picture_shows_the_whole_scene(world: World) -> None:
    picture = Picture(world, size=(64, 48), quality="fast")
    image = picture.draw()
    assert image.shape == (48, 64, 3)
    assert image.dtype == np.uint8
    assert image.std() > 5
    picture.close()
    picture.close()


def test_a_picture_is_of_one_copy() -> None:
    with pytest.raises(InvalidSetup, match="one copy"):
        Picture(World(scene().compile(), copies=2))


@pytest.mark.parametrize("size", [(0, 10), (10, 5000)])
def test_a_size_out_of_range_is_refused(world: World, size: tuple[int, int]) -> None:
    with pytest.raises(InvalidSetup, match="size of a frame"):
        SimCameras(world, [EYE], size=size)


def test_a_camera_without_depth_gives_none(world: World) -> None:
    blind = replace(EYE, camera=replace(REALSENSE_D435, has_depth=False))
    with pytest.raises(InvalidSetup, match="has no depth"):
        SimCameras(world, [blind], has_depth=True)


@pytest.mark.gl
def test_the_matrices_of_a_camera_say_where_the_cuboid_is_in_the_picture() -> None:
    env = rcs.make("PickCuboid", robot="ur5e", cameras=rcs.Cameras(names=("wrist", "overhead"), image_size=(320, 240)))
    observation, info = env.reset(seed=4)
    frame = observation["frames"]["overhead"]
    camera_in_base, cuboid_in_base = frame["extrinsics"], info["cuboid"][:3]
    in_camera = np.linalg.inv(camera_in_base) @ np.append(cuboid_in_base, 1.0)
    u, v, w = frame["intrinsics"] @ in_camera[:3]
    red, green, blue = frame["rgb"][round(v / w), round(u / w)].astype(int)
    assert green > red + 20
    assert green > blue + 20
    before = observation["frames"]["wrist"]["extrinsics"]
    action = env.action_space.sample()
    action["joints"][:] = 0.05
    observation, *_ = env.step(action)
    assert not np.array_equal(observation["frames"]["wrist"]["extrinsics"], before), "it moves with the hand"
    np.testing.assert_array_equal(observation["frames"]["overhead"]["extrinsics"], camera_in_base)
    env.close()
