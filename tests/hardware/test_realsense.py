"""The driver of RealSense cameras, over the vendor's library, plays a recording of what a world drew."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

import rcs
from rcs.devices import Camera, CameraMode
from rcs.errors import DeviceFault, InvalidSetup
from rcs.hardware.realsense import RealsenseDriver, _in_millimetres
from rcs.robots.cameras import REALSENSE_D435, USB_WEBCAM
from rcs.virtual.realsense_recording import write_recording

pytest.importorskip("pyrealsense2", reason="needs the vendor's library and libusb", exc_type=ImportError)
pytestmark = [pytest.mark.gl, pytest.mark.hardware]
SIZE, FPS, BEGIN = (320, 240), 30, 1000.0
MODE = CameraMode(*SIZE, FPS, True)


class Drawn:
    """Pictures that a world drew: a picture per step, of an arm that moves."""

    def __init__(self, path: Path) -> None:
        cameras = rcs.Cameras(names=("side",), image_size=SIZE, depth=True, fps=FPS)
        env = rcs.make("PickCuboid", robot="fr3", cameras=cameras, frequency=FPS)
        frames = [env.reset(seed=0)[0]["frames"]["side"]]
        for _ in range(59):
            action = {"joints": np.full(7, 0.01), "gripper": np.ones(1, np.float32)}
            frames.append(env.step(action)[0]["frames"]["side"])
        env.close()
        self.rgb = [frame["rgb"] for frame in frames]
        self.depth = [frame["depth"] for frame in frames]
        self.matrix = frames[0]["intrinsics"]
        self.path = path
        moments = [BEGIN + i / FPS for i in range(60)]
        assert write_recording(path, zip(self.rgb, self.depth, moments, strict=True), matrix=self.matrix, fps=FPS) == 60


def read_on(camera: Camera, numbers: list[int]) -> None:
    for _ in range(300):
        numbers.append(camera.read().number)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Drawn:
    return Drawn(tmp_path_factory.mktemp("realsense") / "side.db3")


def test_pixels_depth_intrinsics_and_times_are_those_of_the_world(drawn: Drawn) -> None:
    numbers: list[int] = []
    offsets: list[float] = []
    with RealsenseDriver().camera(str(drawn.path), REALSENSE_D435, MODE, {}) as camera:
        calibration = camera.calibration
        assert calibration is not None
        np.testing.assert_allclose(calibration.matrix, drawn.matrix, rtol=1e-6)
        while not numbers or numbers[-1] < 55:
            frame = camera.read()
            i = frame.number - 1
            np.testing.assert_array_equal(frame.rgb, drawn.rgb[i])
            np.testing.assert_array_equal(frame.depth_mm, drawn.depth[i])
            assert frame.device_time == pytest.approx(BEGIN + i / FPS, abs=1e-4)
            assert frame.time <= time.monotonic()
            numbers.append(frame.number)
            offsets.append(frame.time - frame.device_time)
        assert camera.about["model"] == "Virtual RealSense"
    assert len(set(numbers)) > 20
    assert numbers == sorted(numbers)
    assert np.ptp(offsets) < 0.02, "the host's time follows the camera's"


def test_a_recording_that_ends_is_a_fault_and_can_be_played_again_with_numbers_that_go_on(drawn: Drawn) -> None:
    numbers: list[int] = []
    with RealsenseDriver().camera(str(drawn.path), REALSENSE_D435, MODE, {}) as camera:
        with pytest.raises(DeviceFault, match=r"arrive within|not connected"):
            read_on(camera, numbers)
        camera.recover()
        assert 0 < camera.read().number - max(numbers) < 55


def test_without_depth_there_are_colours_alone(drawn: Drawn) -> None:
    with RealsenseDriver().camera(str(drawn.path), REALSENSE_D435, CameraMode(*SIZE, FPS, False), {}) as camera:
        assert camera.read().depth_mm is None


def test_an_environment_sees_the_recording(drawn: Drawn) -> None:
    cameras = rcs.Cameras(names=("side",), image_size=SIZE, depth=True, fps=FPS)
    hardware = {"side": f"realsense:{drawn.path}"}
    with rcs.make("PickCuboid", robot="fr3", cameras=cameras, hardware=hardware) as env:
        frame = env.reset(seed=0)[0]["frames"]["side"]
        assert any(np.array_equal(frame["depth"], one) for one in drawn.depth)
        np.testing.assert_allclose(frame["intrinsics"], drawn.matrix, rtol=1e-6)


def test_a_camera_that_is_absent_is_refused_at_once_and_never_replaced() -> None:
    begin = time.monotonic()
    camera = RealsenseDriver().camera("012345", REALSENSE_D435, MODE, {})
    with pytest.raises(InvalidSetup, match=r"'012345'. Plugged in: "):
        camera.plug()
    with pytest.raises(InvalidSetup, match="Plugged in"):
        camera.open()
    assert time.monotonic() - begin < 5.0, "the library would wait for 15 s"
    hardware = {"side": "realsense:012345"}
    with (
        rcs.make("Free", robot="fr3", cameras=("side",), hardware=hardware) as env,
        pytest.raises(InvalidSetup, match="012345"),
    ):
        env.reset()


def test_options_are_checked() -> None:
    driver = RealsenseDriver()
    for options, words in (({"zoom": 1}, "zoom"), ({"warm_up": -1}, "0 to 5"), ({"latency": "x"}, "0 to 1")):
        with pytest.raises(InvalidSetup, match=words):
            driver.camera("1", REALSENSE_D435, MODE, options)
    with pytest.raises(InvalidSetup, match="no depth"):
        driver.camera("1", USB_WEBCAM, MODE, {})


def test_depth_in_other_units_becomes_millimetres() -> None:
    raw = np.array([[0, 1, 10, 65535]], np.uint16)
    np.testing.assert_array_equal(_in_millimetres(raw, 1.0), raw)
    np.testing.assert_array_equal(_in_millimetres(raw, 0.1), [[0, 0, 1, 6554]])
    np.testing.assert_array_equal(_in_millimetres(raw, 2.0), [[0, 2, 20, 0]])
