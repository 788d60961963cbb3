"""A virtual RealSense shows what its world draws, live, in the vendor's library, whatever goes wrong."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from showing import Showing, truth

import rcs
from rcs.devices import Camera, CameraMode
from rcs.envs.assemble import compose
from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware.realsense import RealsenseDriver
from rcs.robots.camera import CameraMount, looking
from rcs.robots.cameras import REALSENSE_D435
from rcs.setups.make import resolve
from rcs.sim.camera import SimCameras
from rcs.sim.world import World
from rcs.virtual.virtual_world import VirtualWorld, usual_setup

pytest.importorskip("pyrealsense2", reason="needs the vendor's library and libusb", exc_type=ImportError)
pytestmark = [pytest.mark.gl, pytest.mark.hardware]
SIDE = CameraMount(camera="realsense_d435", optical=looking((0.6, 0.5, 0.5), (0.2, 0.0, 0.0)))
SIZE, FPS = (320, 240), 30
MODE = CameraMode(*SIZE, FPS, True)
LATE = 0.05
"""By how much times may be off on a busy machine [s]."""


@pytest.fixture(scope="module")
def running() -> Iterator[Showing]:
    setup = replace(usual_setup("so101"), cameras=rcs.Cameras(mounts={"side": SIDE}))
    running = Showing(VirtualWorld(setup, cameras=("side", "wrist"), depth=True))
    running.start()
    yield running
    running.close()


@pytest.fixture(autouse=True)
def mended(running: Showing) -> Iterator[None]:
    yield
    running.tell("side", "clear")


def realsense(running: Showing, mode: CameraMode = MODE, **options: Any) -> Camera:
    entry = running.sensors.site()["cameras"]["side"]
    return RealsenseDriver().camera(entry["address"], REALSENSE_D435, mode, {**entry["options"], **options})


def drawn(running: Showing, size: tuple[int, int]) -> dict[str, Any]:
    parts = resolve(running.world.setup)
    world = World(compose(parts).compile(), frequency=100)
    world.core.set_state(running.world.world.core.get_state())
    world.refresh()
    there = [one for one in parts.cameras if one.name == "side"]
    return SimCameras(world, there, size=size, has_depth=True).read()["side"]


def read_on(camera: Camera, count: int = 100) -> None:
    for _ in range(count):
        camera.read()


def test_only_cameras_with_depth_are_served_for_the_vendors_library(running: Showing) -> None:
    cameras = running.sensors.site()["cameras"]
    assert {name: entry["driver"] for name, entry in cameras.items()} == {"side": "realsense", "wrist": "webcam"}
    setup = usual_setup("so101")
    with pytest.raises(InvalidSetup, match="depth is True and there are no cameras"):
        VirtualWorld(setup, depth=True)


@pytest.mark.parametrize("size", [SIZE, (1280, 720)])
def test_colours_depth_and_intrinsics_are_exactly_those_of_the_world(running: Showing, size: tuple[int, int]) -> None:
    seen = drawn(running, size)
    assert seen["rgb"].std() > 10, "there is something to see"
    assert np.ptp(seen["depth"][seen["depth"] > 0]) > 100
    with realsense(running, CameraMode(*size, FPS, True)) as camera:
        frame = camera.read()
        np.testing.assert_array_equal(frame.rgb, seen["rgb"])
        np.testing.assert_array_equal(frame.depth_mm, seen["depth"])
        assert camera.calibration is not None
        np.testing.assert_allclose(camera.calibration.matrix, seen["intrinsics"], rtol=1e-6)
        assert camera.about["serial"] == "virtual-side"
        assert camera.about["model"] == REALSENSE_D435.label
    with realsense(running, CameraMode(*size, FPS, False)) as camera:
        frame = camera.read()
        np.testing.assert_array_equal(frame.rgb, seen["rgb"])
        assert frame.depth_mm is None


def test_times_are_when_the_world_was_so(running: Showing) -> None:
    with realsense(running) as camera:
        for _ in range(60):
            frame = camera.read()
            assert abs(frame.time - truth("side", frame.device_time)) < LATE


def test_a_lost_camera_is_a_fault_and_comes_back_with_numbers_that_go_on(running: Showing) -> None:
    with realsense(running) as camera:
        before = camera.read().number
        running.tell("side", "unplug", 600)
        begin = time.monotonic()
        with pytest.raises(DeviceFault, match="has ended the stream"):
            read_on(camera)
        with pytest.raises(DeviceFault, match="no RealSense answers"):
            camera.recover()
        assert time.monotonic() - begin < 3.0
        running.tell("side", "clear")
        camera.recover()
        assert camera.read().number > before


@pytest.mark.parametrize("fault", [("freeze", 600), ("tear",)])
def test_no_whole_picture_is_a_fault(running: Showing, fault: tuple[Any, ...]) -> None:
    with realsense(running) as camera:
        running.tell("side", *fault)
        begin = time.monotonic()
        with pytest.raises(DeviceFault, match=r"arrive within|in time"):
            read_on(camera)
        assert time.monotonic() - begin < 2.5
        begin = time.monotonic()
        camera.close()
        assert time.monotonic() - begin < 1.0


def test_another_camera_in_its_place_is_told(running: Showing) -> None:
    running.tell("side", "swap", "wrist")
    with pytest.raises(DeviceFault, match=r"another camera answers at .*'virtual-wrist', not 'virtual-side'"):
        realsense(running).open()


def test_a_black_picture_is_a_picture_without_depth(running: Showing) -> None:
    with realsense(running) as camera:
        running.tell("side", "black")
        time.sleep(0.3)
        frame = camera.read()
        assert frame.depth_mm is not None
        assert (frame.rgb.max(), frame.depth_mm.max()) == (0, 0)


def test_an_environment_observes_it(running: Showing) -> None:
    cameras = rcs.Cameras(mounts={"side": SIDE}, image_size=SIZE, depth=True, fps=FPS)
    setup = rcs.Setup(task="Free", robot="so101", cameras=cameras)
    site = {"side": running.sensors.site()["cameras"]["side"]}
    with rcs.make(setup, hardware=rcs.Site(cameras=site)) as env:
        frame = env.reset(seed=0)[0]["frames"]["side"]
        np.testing.assert_array_equal(frame["depth"], drawn(running, SIZE)["depth"])


def test_what_does_not_fit_is_refused(running: Showing) -> None:
    for mode, words in (
        (CameraMode(320, 240, 45.0, True), "does not offer 320x240 at 45 Hz; it has 320x180 at 6"),
        (CameraMode(300, 200, 30.0, False), "does not offer 300x200"),
    ):
        with pytest.raises(InvalidSetup, match=words):
            realsense(running, mode).open()
    with pytest.raises(InvalidSetup, match=r"The options \['gain'\] set a camera; http://.* is on a network"):
        realsense(running, gain=3)
    driver = RealsenseDriver()
    with pytest.raises(InvalidSetup, match="valid on a network is 'http://HOST"):
        driver.camera("ftp://127.0.0.1/side", REALSENSE_D435, MODE, {})
    with pytest.raises(InvalidSetup, match="serial is an option at a URL"):
        driver.camera("0123", REALSENSE_D435, MODE, {"serial": "0123"})
    webcam = running.sensors.site()["cameras"]["wrist"]["address"]
    with pytest.raises(InvalidSetup, match="has no depth"):
        driver.camera(webcam, REALSENSE_D435, MODE, {}).open()
    with pytest.raises(DeviceFault, match="no RealSense answers"):
        driver.camera(webcam + "/none", REALSENSE_D435, MODE, {}).open()


class TwoEyes:
    """A pipeline of a camera whose depth has another size and another view: 50 mm beside the colours, of a wall."""

    serial, number = "two-eyes", 0
    WALL, BESIDE = 1000, 0.05

    def __init__(self, rs: Any, url: str, *, serial: str) -> None:
        self.rs, self.device, self.syncer = rs, rs.software_device(), rs.syncer()
        self.sensors, self.profiles = [], []
        kinds = ((rs.stream.color, rs.format.rgb8, 3, SIZE), (rs.stream.depth, rs.format.z16, 2, (640, 480)))
        for uid, (kind, format, count, (width, height)) in enumerate(kinds):  # noqa: A001
            stream, seen = rs.video_stream(), rs.intrinsics()
            seen.width, seen.height, seen.fx, seen.fy = width, height, float(width), float(width)
            seen.ppx, seen.ppy, seen.model, seen.coeffs = (
                (width - 1) / 2,
                (height - 1) / 2,
                rs.distortion.none,
                [0.0] * 5,
            )
            stream.type, stream.index, stream.uid, stream.fmt, stream.bpp = kind, 0, uid, format, count
            stream.width, stream.height, stream.fps, stream.intrinsics = width, height, FPS, seen
            self.sensors.append(self.device.add_sensor(str(kind)))
            self.profiles.append(self.sensors[-1].add_video_stream(stream).as_video_stream_profile())
        self.sensors[1].add_read_only_option(rs.option.depth_units, 0.001)
        beside = rs.extrinsics()
        beside.rotation, beside.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [self.BESIDE, 0, 0]
        self.profiles[1].register_extrinsics_to(self.profiles[0], beside)

    def start(self, streams: Any) -> TwoEyes:
        assert [stream[1:3] for stream in streams] == [SIZE, (640, 480)], "depth has the largest size that there is"
        for sensor, profile in zip(self.sensors, self.profiles, strict=True):
            sensor.open(profile)
            sensor.start(self.syncer)
        return self

    def get_device(self) -> Any:
        return self.device

    def get_stream(self, kind: Any) -> Any:
        return self.profiles[kind == self.rs.stream.depth]

    def wait_for_frames(self, limit: int) -> Any:
        self.number += 1
        for sensor, profile, value, count in zip(self.sensors, self.profiles, (200, self.WALL), (3, 2), strict=True):
            frame, width = self.rs.software_video_frame(), profile.width()
            shape = (profile.height(), width, 3)[:count]
            frame.pixels, frame.bpp, frame.stride = np.full(shape, value, f"u{1 + (count == 2)}"), count, width * count
            frame.timestamp, frame.domain = 1e3 * self.number / FPS, self.rs.timestamp_domain.hardware_clock
            frame.frame_number, frame.profile = self.number, profile
            if count == 2:
                frame.depth_units = 0.001
            sensor.set_metadata(self.rs.frame_metadata_value.actual_fps, 1000 * FPS)
            sensor.on_video_frame(frame)
        return self.syncer.wait_for_frames(limit)

    def poll_for_frames(self) -> Any:
        return self.syncer.poll_for_frames()

    def stop(self) -> None:
        for sensor in self.sensors:
            sensor.stop()
            sensor.close()


def test_depth_of_another_eye_is_aligned_to_the_colours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs.hardware.realsense.NetworkPipeline", TwoEyes)
    with RealsenseDriver().camera("http://127.0.0.1/eyes", REALSENSE_D435, MODE, {}) as camera:
        depth = camera.read().depth_mm
    assert depth is not None
    assert depth.shape == SIZE[::-1]
    # A point of the wall is 0.05 m, 16 px at 320 px of focal length and 1 m, farther right for the colours.
    shift = round(TwoEyes.BESIDE * SIZE[0] / (TwoEyes.WALL / 1000))
    assert not depth[:, : shift - 1].any()
    assert (depth[2:-2, shift + 1 : -2] == TwoEyes.WALL).mean() > 0.99
