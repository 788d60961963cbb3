from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import mujoco
import numpy as np
import pytest

from rcs.robots.cameras import REALSENSE_D435
from rcs.robots.description import Mount
from rcs.sim import CameraPlacement, World
from rcs.sim.camera import SimCameras
from rcs.sim.camera_feed import CameraFeed, FrameClock, FrameRate
from rcs.sim.scene import Scene
from rcs.sim.world import Copies

pytestmark = pytest.mark.gl
SIZE = (40, 30)
BALL = "ball"


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    """A ball that is pulled aside and carries the camera `low`, and two more cameras that see it."""
    scene = Scene.empty()
    scene.spec.option.gravity = [5.0, 0.0, 0.0]
    body = scene.spec.worldbody.add_body(name=BALL, pos=[0.0, 0.0, 0.5])
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.1, 0.0, 0.0], rgba=[1, 0, 0, 1])
    for placement in PLACEMENTS:
        scene.add_camera(placement)
    return scene.compile()


def placed(name: str, x: float, parent: str = "world") -> CameraPlacement:
    """A camera a metre above a body, looking straight down."""
    down = Mount(translation=(x, 0.0, 1.0), quaternion=(1.0, 0.0, 0.0, 0.0))
    return CameraPlacement(name=name, camera=REALSENSE_D435, parent_body=parent, optical_in_parent=down)


PLACEMENTS = [placed("fast", 0.1), placed("slow", -0.1), placed("low", 0.05, BALL)]
RATES = {"fast": FrameRate(fps=60), "slow": FrameRate(fps=15), "low": FrameRate(fps=15)}


class Spied(SimCameras):
    """Cameras that note what they were asked to draw."""

    def read(self, names: Sequence[str] | None = None, copies: Copies = None) -> dict[str, dict[str, Any]]:
        self.asked.append((tuple(names or self.names), None if copies is None else copies.tolist()))
        return super().read(names, copies)

    asked: list[tuple[tuple[str, ...], list[int] | None]]


@pytest.fixture(params=[None, 3], ids=["one", "copies"])
def world(request: pytest.FixtureRequest, model: mujoco.MjModel) -> World:
    world = World(model, frequency=60.0, copies=request.param)
    world.reset()
    world.refresh()
    return world


def feed_of(world: World, **options: Any) -> tuple[CameraFeed, Spied]:
    cameras = Spied(world, PLACEMENTS, size=SIZE, **options)
    cameras.asked = []
    return CameraFeed(cameras, FrameClock(world, RATES)), cameras


@pytest.fixture
def feed(world: World) -> Iterator[tuple[CameraFeed, Spied]]:
    feed, cameras = feed_of(world, has_depth=True)
    yield feed, cameras
    cameras.close()


def test_a_frame_is_given_again_with_all_that_belongs_to_it_until_the_next_is_due(
    world: World, feed: tuple[CameraFeed, Spied]
) -> None:
    newest, cameras = feed
    taken = newest.read()
    for step in range(1, 10):
        world.advance()
        given, present = newest.read(), cameras.read()
        if step % 4 == 0:
            assert not np.array_equal(present["slow"]["rgb"], taken["slow"]["rgb"])
            taken = present
        for name in ("slow", "low"):
            for key in ("rgb", "depth", "intrinsics", "extrinsics"):
                np.testing.assert_array_equal(given[name][key], taken[name][key])
        np.testing.assert_array_equal(given["fast"]["rgb"], present["fast"]["rgb"])
        if step % 4:
            assert not np.array_equal(given["low"]["extrinsics"], present["low"]["extrinsics"])


def test_only_what_is_due_is_drawn(world: World, feed: tuple[CameraFeed, Spied]) -> None:
    newest, cameras = feed
    newest.read()
    first = dict(cameras.capture_times)
    for _ in range(4):
        world.advance()
        newest.read()
    everything, fast = (("fast", "slow", "low"), None), (("fast",), None)
    assert cameras.asked == [everything, fast, fast, fast, everything]
    world.advance()
    last = dict(cameras.capture_times)
    newest.read()
    assert cameras.capture_times["slow"] == last["slow"] > first["slow"]
    assert cameras.capture_times["fast"] > last["fast"]


def test_a_camera_without_a_new_frame_gives_the_same_arrays_and_nobody_can_write_to_them(
    world: World, feed: tuple[CameraFeed, Spied]
) -> None:
    newest, _ = feed
    shown = newest.read()
    handed_out: list[tuple[Any, Any]] = []
    for step in range(1, 10):
        world.advance()
        given = newest.read()
        for name, key in itertools.product(given, ("rgb", "depth", "intrinsics", "extrinsics")):
            values = given[name][key]
            is_new = name == "fast" or step % 4 == 0
            assert (values is shown[name][key]) != is_new
            handed_out.append((values, values.copy()))
            with pytest.raises(ValueError, match="read-only"):
                values[...] = 0
        shown = given
    for values, kept in handed_out:
        np.testing.assert_array_equal(values, kept)


def test_what_is_done_to_the_dictionaries_of_a_frame_is_not_seen_again(
    world: World, feed: tuple[CameraFeed, Spied]
) -> None:
    newest, _ = feed
    newest.read()["slow"].clear()
    world.advance()
    assert set(newest.read()["slow"]) == {"rgb", "depth", "intrinsics", "distortion", "extrinsics"}


@pytest.mark.parametrize("is_varied", [False, True])
@pytest.mark.parametrize("has_noise", [False, True])
def test_a_copy_that_starts_anew_is_drawn_and_the_others_keep_their_frames(
    model: mujoco.MjModel, is_varied: bool, has_noise: bool
) -> None:
    world = World(model, frequency=60.0, copies=3)
    world.reset()
    if is_varied:
        world.vary("cam_fovy")[1] *= 1.2
    world.refresh()
    newest, cameras = feed_of(world, has_depth=True, has_noise=has_noise)
    before = newest.read()
    for _ in range(6):
        world.advance()
        before = newest.read()
    one = np.array([1], np.int32)
    world.reset(one)
    world.qpos[1, :2] = 0.2
    world.refresh(one)
    cameras.asked.clear()
    after, present = newest.read(), cameras.read()
    assert cameras.asked[:2] == [(("fast",), None), (("slow", "low"), [1])]
    for name in ("slow", "low"):
        for key, values in after[name].items():
            np.testing.assert_array_equal(values[[0, 2]], before[name][key][[0, 2]])
            np.testing.assert_array_equal(values[1], present[name][key][1])
            assert values is not before[name][key]
        assert not np.array_equal(after["slow"]["rgb"][1], before["slow"]["rgb"][1])
    cameras.close()


def test_some_cameras_and_copies_are_drawn_like_all(world: World, feed: tuple[CameraFeed, Spied]) -> None:
    _, cameras = feed
    for _ in range(5):
        world.advance()
    whole = cameras.read()
    some = cameras.read(["low", "fast"])
    assert list(some) == ["low", "fast"]
    for name, frame in some.items():
        for key, values in frame.items():
            np.testing.assert_array_equal(values, whole[name][key])
    if world.leading:
        rows = np.array([2, 0], np.int32)
        for key, values in cameras.read(["slow"], rows)["slow"].items():
            np.testing.assert_array_equal(values, whole["slow"][key][rows])


def test_a_mode_has_exactly_the_intrinsics_of_the_device(model: mujoco.MjModel) -> None:
    world = World(model)
    for mode in REALSENSE_D435.modes:
        if mode.width > 640:
            continue  # costs time and shows nothing new
        cameras = SimCameras(world, [PLACEMENTS[0]], size=(mode.width, mode.height))
        matrix = cameras.read()["fast"]["intrinsics"]
        np.testing.assert_allclose(matrix, REALSENSE_D435.intrinsics(mode.width, mode.height), rtol=1e-14)
        cameras.close()
