"""A camera that is gone for some time does not keep episodes from beginning, and counts in its own episode alone."""

from __future__ import annotations

import pytest

from rcs.devices import CameraMode
from rcs.devices.fakes import FakeCamera
from rcs.errors import InvalidSetup
from rcs.hardware.usb import Plug, UsbDevice, find
from tests.envs.ports.test_camera import make, stay

MODE = CameraMode(640, 480, 30.0, False)


def test_a_camera_that_is_unplugged_between_episodes_keeps_none_from_beginning() -> None:
    class Plugged(FakeCamera):
        is_in = True

        def plug(self) -> Plug:
            there = [UsbDevice(path="1-2", serial="A1", speed=480)] if self.is_in else []
            return Plug(device=find("A1", there, "webcam"), needs=1)

    plugged = Plugged(MODE, name="side")
    env = make(plugged, on_stale="flag", stale_after=60.0)
    env.reset(seed=0)
    plugged.is_in = False
    plugged.lose_link()
    env.reset(seed=1)
    env.step(stay(env))
    env.close()
    with make(plugged) as another, pytest.raises(InvalidSetup, match="A1"):
        another.reset(seed=0)
