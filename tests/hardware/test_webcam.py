"""Webcams and DIGITs over their wire show what the virtual world drew, with true times, whatever goes wrong."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import simplejpeg
from rcs_data import Dataset
from showing import Showing, truth

import rcs
from rcs.devices import Camera, CameraMode
from rcs.envs.assemble import compose
from rcs.errors import DeviceFault, InvalidSetup, RcsError, UnknownName
from rcs.hardware.digit import DigitDriver
from rcs.hardware.webcam import WebcamDriver
from rcs.robots.cameras import USB_WEBCAM
from rcs.robots.tactile import DIGIT
from rcs.setups.make import resolve
from rcs.sim.camera import SimCameras
from rcs.sim.tactile import SimTactile
from rcs.sim.world import World
from rcs.spatial import Pose, wxyz_to_xyzw
from rcs.virtual.sensors import DRIFT
from rcs.virtual.virtual_world import VirtualWorld, usual_setup

pytestmark = [pytest.mark.gl, pytest.mark.hardware]
MODE = CameraMode(320, 240, 30.0, False)
LATE = 0.05
"""By how much times may be off on a busy machine [s]; docs/hardware.md has what is measured on an idle one."""


class Running(Showing):
    """A virtual world that holds the cuboid between its gels."""

    def __init__(self) -> None:
        super().__init__(VirtualWorld(usual_setup("so101"), cameras=("wrist", "diagonal"), tactile=True))
        self.skin = SimTactile(self.world.world, resolve(self.world.setup).tactile[1])
        self._grasp()
        self.start()

    def _grasp(self) -> None:
        """Put the cuboid against a gel, its shorter edge across, where it floats, and close the gripper."""
        world = self.world.world
        data, cuboid = world.data, world.model.body("cuboid").id
        assert data is not None
        sensor = data.body(self.skin.placement.body_name)
        x, y, z = DIGIT.gel_center
        half_edge = world.model.geom("cuboid").size[1]
        beside = Pose((x + half_edge + 1e-4, y, z), (0.0, 0.0, -np.sqrt(0.5), np.sqrt(0.5)))
        place = Pose(sensor.xpos, wxyz_to_xyzw(sensor.xquat)) * beside
        self.world._simulation.task.place({"cuboid": place.tquat}, ...)
        data.xfrc_applied[cuboid, 2] = 9.81 * world.model.body_mass[cuboid]
        self.world.robots["so101"].body.command_opening(np.zeros(1))
        for _ in range(1250):
            world.advance()


@pytest.fixture(scope="module")
def running() -> Iterator[Running]:
    running = Running()
    yield running
    running.close()


@pytest.fixture(autouse=True)
def mended(running: Running) -> Iterator[None]:
    yield
    for name in running.sensors.names:
        running.tell(name, "clear")


def webcam(running: Running, name: str = "wrist", mode: CameraMode = MODE) -> Camera:
    entry = running.sensors.site()["cameras"][name]
    return WebcamDriver().camera(entry["address"], USB_WEBCAM, mode, entry["options"])


def digit(running: Running, name: str) -> Camera:
    entry = running.sensors.site()["tactile"][name]
    return DigitDriver().tactile(entry["address"], DIGIT, CameraMode(*DIGIT.frame_size, 60.0, False), entry["options"])


def read_on(camera: Camera, count: int = 100) -> None:
    """Read pictures of the wrist, all of which are whole and have their own times."""
    for _ in range(count):
        frame = camera.read()
        assert frame.rgb.std() > 5, "no picture is torn"
        assert abs(frame.time - truth("wrist", frame.device_time)) < LATE


def wait_for(what: Callable[[], bool], limit: float = 60.0) -> None:
    end = time.monotonic() + limit
    while not what():
        assert time.monotonic() < end, f"waited for {limit} s"
        time.sleep(0.02)


def test_the_end_of_a_name_is_enough_where_no_other_sensor_has_it(running: Running) -> None:
    running.tell("left", "swap", "right")
    with pytest.raises(DeviceFault, match="another camera answers"), digit(running, "so101_left"):
        pass
    running.tell("left", "clear")
    with digit(running, "so101_left") as left:
        left.read()
    for name in ("middle", "eft", "t"):
        with pytest.raises(UnknownName, match="so101_left"):
            running.tell(name, "black")


def test_pictures_are_those_that_the_world_drew(running: Running) -> None:
    parts = resolve(running.world.setup)
    world = World(compose(parts).compile(), frequency=100)
    world.core.set_state(running.world.world.core.get_state())
    world.refresh()
    for name in ("wrist", "diagonal"):
        drawn = SimCameras(world, list(parts.cameras), size=(320, 240)).read([name])[name]["rgb"]
        with webcam(running, name) as camera:
            shown = camera.read().rgb
        assert drawn.std() > 10, "there is something to see"
        assert np.abs(drawn.astype(int) - shown).mean() <= 2.0
    felt, rest = running.skin.read()["rgb"], SimTactile(world, running.skin.placement).read()["rgb"]
    with digit(running, running.skin.placement.name) as sensor:
        shown = sensor.read().rgb.astype(int)
    assert np.abs(shown - rest).max() > 15, "it shows what is held"
    for pixels in ((felt != rest).any(axis=2), (felt == rest).all(axis=2)):
        assert np.abs(shown - felt)[pixels].mean() <= 3.0
    world.close()


def test_times_are_those_of_the_pictures(running: Running) -> None:
    off: list[float] = []
    with webcam(running) as camera:
        for _ in range(45):
            frame = camera.read()
            assert frame.time < time.monotonic()
            off.append(frame.time - truth("wrist", frame.device_time))
    assert min(off) > -0.005 and np.percentile(off, 90) < LATE, off


@pytest.mark.parametrize("fault", [("delay", 300), ("drop", 0.5), ("tear",), ("freeze", 0.5)])
def test_no_frame_has_a_false_time(running: Running, fault: tuple[Any, ...]) -> None:
    with webcam(running) as camera:
        for _ in range(15):
            camera.read()
        running.tell("wrist", *fault)
        if fault == ("tear",):
            with pytest.raises(DeviceFault, match="damaged"):
                read_on(camera)
        else:
            read_on(camera, 20)
        running.tell("wrist", "clear")
        if camera.fault:
            camera.recover()
        read_on(camera, 3)


def test_reading_late_gives_the_newest_picture(running: Running) -> None:
    with webcam(running) as camera:
        first = camera.read()
        time.sleep(1.0)
        frame = camera.read()
        assert frame.number - first.number > 5
        assert time.monotonic() - frame.time < 0.5


def test_a_black_picture_is_a_picture(running: Running) -> None:
    with webcam(running) as camera:
        running.tell("wrist", "black")
        wait_for(lambda: camera.read().rgb.max() < 5)


def test_an_unplugged_camera_is_a_fault_until_it_is_back(running: Running) -> None:
    with webcam(running) as camera:
        camera.read()
        running.tell("wrist", "unplug", 0.5)
        with pytest.raises(DeviceFault, match=r"ended the stream|lost"):
            read_on(camera)
        time.sleep(0.6)
        camera.recover()
        assert camera.read().rgb.std() > 5


def test_another_camera_at_the_same_place_is_refused(running: Running) -> None:
    with webcam(running) as camera:
        camera.read()
        running.tell("wrist", "swap", "diagonal")
        with pytest.raises(DeviceFault):
            read_on(camera)
        with pytest.raises(DeviceFault, match=r"another camera .*'virtual-diagonal', not 'virtual-wrist'"):
            camera.recover()


def test_what_is_not_offered_is_refused_with_what_is(running: Running) -> None:
    with pytest.raises(InvalidSetup, match="640x480 at"), webcam(running, mode=CameraMode(123, 45, 30.0, False)):
        pass
    with pytest.raises(InvalidSetup, match="no depth"):
        webcam(running, mode=CameraMode(640, 480, 30.0, True))
    driver, address = WebcamDriver(), "http://127.0.0.1:9/wrist"
    with pytest.raises(InvalidSetup, match="zoom"):
        driver.camera(address, USB_WEBCAM, MODE, {"zoom": 2})
    with pytest.raises(InvalidSetup, match=r"\['gain'\] are for a USB port"):
        driver.camera(address, USB_WEBCAM, MODE, {"gain": 2})
    with pytest.raises(InvalidSetup, match="warm_up is 60 s; valid is 0 to 5"):
        driver.camera(address, USB_WEBCAM, MODE, {"warm_up": 60})
    with pytest.raises(DeviceFault, match="no camera answers"), driver.camera(address, USB_WEBCAM, MODE, {}):
        pass
    with pytest.raises(InvalidSetup, match="http://HOST"):
        driver.camera("rtsp://127.0.0.1/wrist", USB_WEBCAM, MODE, {})
    with pytest.raises(InvalidSetup, match="0 to 15"):
        DigitDriver().tactile("D20001", DIGIT, MODE, {"lights": (1, 2, 16)})
    for words in (("wrist", "jump"), ("wrists", "black")):
        with pytest.raises(UnknownName):
            running.tell(*words)
    for words in (("wrist", "drop", 3), ("wrist", "swap", "nobody"), ("wrist", "freeze")):
        with pytest.raises(RcsError):
            running.tell(*words)


def test_an_environment_goes_through_freezes_losses_and_returns(running: Running, tmp_path: Path) -> None:
    site = {name: running.sensors.site()["cameras"][name] for name in ("wrist", "diagonal")}
    cameras = rcs.Cameras(names=("wrist", "diagonal"), image_size=(320, 240), fps=30)
    hardware = rcs.Site(cameras=site, on_stale="flag", stale_after=0.4)
    env = rcs.make("PickCuboid", robot="so101", cameras=cameras, hardware=hardware, max_episode_steps=None)
    stay = {"joints": np.zeros(5), "gripper": np.ones(1, np.float32)}
    with rcs.record(env, tmp_path / "takes") as takes:
        takes.start(at_reset=True)
        env.reset(seed=0)
        for fault in (("freeze", 1.0), ("unplug", 1.0), ("drop", 0.5)):
            running.tell("wrist", *fault)
            for _ in range(60):
                env.step(stay)
            running.tell("wrist", "clear")
        wait_for(lambda: env.step(stay)[-1]["ages"]["frames/wrist"] < 0.4)
        takes.finish(None)
    begin = time.monotonic()
    env.close()
    assert time.monotonic() - begin < 1.5
    episode = Dataset.open(tmp_path / "takes").episodes[0]
    assert episode.length > 180, "no row is lost"
    for name in site:
        seen = episode.column(f"time/frames/{name}")
        at = episode.column(f"time/device/frames/{name}")
        off = seen - np.array([truth(name, one) for one in at])
        assert (np.abs(off) < 0.1).all(), "no frame has a false time"
    assert episode.outcome["reconnections"]["frames/wrist"] >= 1
    assert episode.outcome["cameras"]["wrist"]["serial"] == "virtual-wrist"
    clock = episode.timing["devices"]["frames/diagonal"]["clock"]
    assert clock["drift"] == pytest.approx(DRIFT, abs=2e-3)


def test_a_stream_without_a_clock_is_never_taken_for_younger_than_it_may_be() -> None:
    import socket

    server = socket.create_server(("127.0.0.1", 0))
    jpeg = simplejpeg.encode_jpeg(np.full((240, 320, 3), 99, np.uint8))
    camera = WebcamDriver().camera(f"http://127.0.0.1:{server.getsockname()[1]}/", USB_WEBCAM, MODE, {})
    part = f"Content-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n".encode() + jpeg

    def answer() -> None:
        connection, _ = server.accept()
        connection.recv(4096)
        connection.sendall(b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=x\r\n\r\n")
        for _ in range(3):  # those that are dropped
            connection.sendall(b"--x\r\n" + part)
            time.sleep(0.3)
        connection.sendall(b"--x\r\n" + part + b"\r\n--x\r\n")
        time.sleep(0.3)
        connection.sendall(part)
        ended.wait(10.0)
        connection.close()

    ended = threading.Event()
    thread = threading.Thread(target=answer)
    thread.start()
    with camera:
        first = camera.read()
        assert first.rgb.mean() == pytest.approx(99, abs=2)
        read = time.monotonic()
        time.sleep(0.8)  # the second picture comes meanwhile
        second = camera.read()
        assert second.number == first.number + 1
        assert first.time < second.time <= read + 0.1, "it may be as old as that"
        ended.set()
    thread.join()
    server.close()
