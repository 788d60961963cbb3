"""The contracts of cameras and tactile sensors, on fakes, and over the wires of virtual ones."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from typing import Any, ClassVar

import pytest

import rcs
from rcs.devices import Camera, CameraMode
from rcs.hardware.digit import DigitDriver
from rcs.hardware.realsense import RealsenseDriver
from rcs.hardware.webcam import WebcamDriver
from rcs.robots.camera import CameraMount, looking
from rcs.robots.cameras import REALSENSE_D435, USB_WEBCAM
from rcs.robots.tactile import DIGIT
from rcs.testing import CameraContract, TactileContract
from rcs.virtual import VirtualProcess

pytestmark = [pytest.mark.gl, pytest.mark.hardware, pytest.mark.slow]
GONE = 600


class Served:
    """The parts that the contracts of virtual sensors share."""

    virtual: ClassVar[VirtualProcess]
    name: ClassVar[str]
    setup = rcs.Setup(task="Free", robot="so101", cameras="wrist")
    has_depth = False
    rate_tolerance = 0.5  # on a busy machine
    read_limit = 2.5

    @pytest.fixture(autouse=True, scope="class")
    def _serve(self, request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
        file = tmp_path_factory.mktemp("served") / "setup.json"
        file.write_text(json.dumps(self.setup.to_json()), "utf-8")
        names = self.setup.cameras.names
        with VirtualProcess(
            "so101", setup=file, cameras=names, depth=self.has_depth, tactile=True
        ) as request.cls.virtual:
            yield

    @pytest.fixture(autouse=True)
    def _mended(self) -> Iterator[None]:
        yield
        self.virtual.tell(f"{self.name}/clear")

    def lose_link(self, device: Any) -> None:
        self.virtual.tell(f"{self.name}/unplug", GONE)
        time.sleep(0.3)

    def restore_link(self, device: Any) -> None:
        self.virtual.tell(f"{self.name}/clear")


class TestVirtualWebcam(Served, CameraContract):
    name = "wrist"

    def make_device(self) -> Camera:
        entry: Any = self.virtual.site.cameras["wrist"]
        return WebcamDriver().camera(entry.address, USB_WEBCAM, CameraMode(320, 240, 15.0, False), entry.options)


class TestVirtualRealsense(Served, CameraContract):
    name = "side"
    setup = rcs.Setup(
        task="Free",
        robot="so101",
        cameras=rcs.Cameras(
            mounts={"side": CameraMount(camera="realsense_d435", optical=looking((0.6, 0.5, 0.5), (0.2, 0.0, 0.0)))}
        ),
    )
    has_depth = True

    def make_device(self) -> Camera:
        pytest.importorskip("pyrealsense2", reason="needs the vendor's library and libusb", exc_type=ImportError)
        entry: Any = self.virtual.site.cameras["side"]
        return RealsenseDriver().camera(entry.address, REALSENSE_D435, CameraMode(320, 240, 30.0, True), entry.options)


class TestVirtualDigit(Served, TactileContract):
    name = "so101_left"

    def make_device(self) -> Camera:
        entry: Any = self.virtual.site.tactile["so101_left"]
        return DigitDriver().tactile(entry.address, DIGIT, CameraMode(*DIGIT.frame_size, 60.0, False), entry.options)
