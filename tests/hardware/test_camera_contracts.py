"""The contracts of cameras and tactile sensors, on fakes, and over the wires of virtual ones."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any, ClassVar

import pytest

from rcs.devices import Camera, CameraMode
from rcs.hardware.digit import DigitDriver
from rcs.hardware.webcam import WebcamDriver
from rcs.robots.cameras import USB_WEBCAM
from rcs.robots.tactile import DIGIT
from rcs.testing import CameraContract, TactileContract
from rcs.virtual import VirtualProcess

pytestmark = [pytest.mark.gl, pytest.mark.hardware, pytest.mark.slow]
GONE = 600


class Served:
    """The parts that the contracts of virtual sensors share."""

    virtual: ClassVar[VirtualProcess]
    name: ClassVar[str]
    rate_tolerance = 0.5  # on a busy machine
    read_limit = 2.5

    @pytest.fixture(autouse=True, scope="class")
    def _serve(self, request: pytest.FixtureRequest) -> Iterator[None]:
        with VirtualProcess("so101", cameras=("wrist",), tactile=True) as request.cls.virtual:
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


class TestVirtualDigit(Served, TactileContract):
    name = "so101_left"

    def make_device(self) -> Camera:
        entry: Any = self.virtual.site.tactile["so101_left"]
        return DigitDriver().tactile(entry.address, DIGIT, CameraMode(*DIGIT.frame_size, 60.0, False), entry.options)
