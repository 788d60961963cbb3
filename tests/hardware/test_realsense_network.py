"""A virtual RealSense shows what its world draws, live, in the vendor's library, whatever goes wrong."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

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
from rcs.virtual.sensors import DRIFT, device_time
from rcs.virtual.virtual_world import VirtualWorld, usual_setup

pytest.importorskip("pyrealsense2", reason="needs the vendor's library and libusb", exc_type=ImportError)
pytestmark = [pytest.mark.gl, pytest.mark.hardware]
SIDE = CameraMount(camera="realsense_d435", optical=looking((0.6, 0.5, 0.5), (0.2, 0.0, 0.0)))
SIZE, FPS = (320, 240), 30
MODE = CameraMode(*SIZE, FPS, True)
LATE = 0.05
"""By how much times may be off on a busy machine [s]."""


class Running:
    """A virtual world that shows its state, which stays, on a thread."""

    def __init__(self) -> None:
        setup = replace(usual_setup("so101"), cameras=rcs.Cameras(mounts={"side": SIDE}))
        self.world = VirtualWorld(setup, cameras=("side", "wrist"), depth=True)
        assert self.world.sensors is not None
        self.sensors = self.world.sensors
        self._must_end = threading.Event()
        self._thread = threading.Thread(target=self._show, name="world", daemon=True)
        self._thread.start()

    def _show(self) -> None:
        while not self._must_end.wait(0.005):
            self.sensors.show()

    def tell(self, *words: object) -> None:
        self.world.tell([str(word) for word in words])

    def close(self) -> None:
        self._must_end.set()
        self._thread.join()
        self.world.close()


@pytest.fixture(scope="module")
def running() -> Iterator[Running]:
    running = Running()
    yield running
    running.close()


@pytest.fixture(autouse=True)
def mended(running: Running) -> Iterator[None]:
    yield
    running.tell("side", "clear")


def realsense(running: Running, mode: CameraMode = MODE, **options: Any) -> Camera:
    entry = running.sensors.site()["cameras"]["side"]
    return RealsenseDriver().camera(entry["address"], REALSENSE_D435, mode, {**entry["options"], **options})


def drawn(running: Running, size: tuple[int, int]) -> dict[str, Any]:
    parts = resolve(running.world.setup)
    world = World(compose(parts).compile(), frequency=100)
    world.core.set_state(running.world.world.core.get_state())
    world.refresh()
    there = [one for one in parts.cameras if one.name == "side"]
    return SimCameras(world, there, size=size, has_depth=True).read()["side"]


def read_on(camera: Camera, count: int = 100) -> None:
    for _ in range(count):
        camera.read()


def test_only_cameras_with_depth_are_served_for_the_vendors_library(running: Running) -> None:
    cameras = running.sensors.site()["cameras"]
    assert {name: entry["driver"] for name, entry in cameras.items()} == {"side": "realsense", "wrist": "webcam"}
    setup = usual_setup("so101")
    with pytest.raises(InvalidSetup, match="depth is True and there are no cameras"):
        VirtualWorld(setup, depth=True)


@pytest.mark.parametrize("size", [SIZE, (1280, 720)])
def test_colours_depth_and_intrinsics_are_exactly_those_of_the_world(running: Running, size: tuple[int, int]) -> None:
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


def test_times_are_when_the_world_was_so(running: Running) -> None:
    with realsense(running) as camera:
        for _ in range(60):
            frame = camera.read()
            truth = (frame.device_time - device_time("side", 0.0)) / (1.0 - DRIFT)
            assert abs(frame.time - truth) < LATE


def test_a_lost_camera_is_a_fault_and_comes_back_with_numbers_that_go_on(running: Running) -> None:
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
def test_no_whole_picture_is_a_fault(running: Running, fault: tuple[Any, ...]) -> None:
    with realsense(running) as camera:
        running.tell("side", *fault)
        begin = time.monotonic()
        with pytest.raises(DeviceFault, match="arrive within"):
            read_on(camera)
        assert time.monotonic() - begin < 2.5
        begin = time.monotonic()
        camera.close()
        assert time.monotonic() - begin < 1.0


def test_another_camera_in_its_place_is_told(running: Running) -> None:
    running.tell("side", "swap", "wrist")
    with pytest.raises(DeviceFault, match=r"another camera answers at .*'virtual-wrist', not 'virtual-side'"):
        realsense(running).open()


def test_a_black_picture_is_a_picture_without_depth(running: Running) -> None:
    with realsense(running) as camera:
        running.tell("side", "black")
        time.sleep(0.3)
        frame = camera.read()
        assert frame.depth_mm is not None
        assert (frame.rgb.max(), frame.depth_mm.max()) == (0, 0)


def test_an_environment_observes_it(running: Running) -> None:
    cameras = rcs.Cameras(mounts={"side": SIDE}, image_size=SIZE, depth=True, fps=FPS)
    setup = rcs.Setup(task="Free", robot="so101", cameras=cameras)
    site = {"side": running.sensors.site()["cameras"]["side"]}
    with rcs.make(setup, hardware=rcs.Site(cameras=site)) as env:
        frame = env.reset(seed=0)[0]["frames"]["side"]
        np.testing.assert_array_equal(frame["depth"], drawn(running, SIZE)["depth"])


def test_what_does_not_fit_is_refused(running: Running) -> None:
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
    with pytest.raises(InvalidSetup, match="is its address, not an option"):
        driver.camera("0123", REALSENSE_D435, MODE, {"serial": "0123"})
    webcam = running.sensors.site()["cameras"]["wrist"]["address"]
    with pytest.raises(InvalidSetup, match="has no depth"):
        driver.camera(webcam, REALSENSE_D435, MODE, {}).open()
    with pytest.raises(DeviceFault, match="no RealSense answers"):
        driver.camera(webcam + "/none", REALSENSE_D435, MODE, {}).open()
