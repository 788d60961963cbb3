"""The thread of a camera is the only one that makes frames, and connects it; what others add to frames is not lost."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np
import pytest

from rcs.devices import CameraMode, Frame
from rcs.devices.fakes import FakeCamera
from rcs.envs.ports.camera_thread import CameraFeedThread
from rcs.errors import DeviceFault
from rcs.hardware.pictures import Picture
from rcs.hardware.video_camera import VideoCamera


def test_what_is_added_to_a_frame_is_in_one_that_is_being_made_meanwhile_too() -> None:
    fixed, is_making, may_go_on = {"matrix": 1}, threading.Event(), threading.Event()
    may_go_on.set()

    def take(frame: Frame) -> dict[str, Any]:
        made = {"number": frame.number, **fixed}
        if not may_go_on.is_set():
            is_making.set()
            may_go_on.wait(20.0)
        return made

    feed = CameraFeedThread("side", FakeCamera(CameraMode(64, 48, 100.0, False)), take)
    assert feed.start()
    feed.wait(time.monotonic() + 20.0)
    may_go_on.clear()
    assert is_making.wait(20.0)
    fixed["matrix"] = 2
    amending = threading.Thread(target=feed.amend, args=({"matrix": 2},), name="amends")
    amending.start()
    amending.join(0.1)
    feed.end()  # no later frame, which would have it anyway
    may_go_on.set()
    amending.join(20.0)
    feed.close()
    assert feed.newest is not None
    assert feed.newest[0]["matrix"] == 2


def test_a_thread_that_runs_is_not_started_again() -> None:
    feed = CameraFeedThread("side", FakeCamera(CameraMode(64, 48, 100.0, False)), lambda frame: {"n": frame.number})
    assert feed.start()
    assert not feed.start()
    feed.close()
    assert feed.start()
    feed.close()


def test_a_fault_from_before_does_not_delay_the_first_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs.envs.ports.camera_thread.RECONNECT", 60.0)
    camera = FakeCamera(CameraMode(64, 48, 100.0, False))
    camera.set_fault("its cable was out")
    feed = CameraFeedThread("side", camera, lambda frame: {"number": frame.number})
    feed.start()
    feed.wait(time.monotonic() + 20.0)
    assert not feed.failure
    assert not camera.fault
    feed.close()


class Counted:
    """A source of pictures that counts connections, and fails once when it is told to."""

    serial, clock = "A1", None

    def __init__(self) -> None:
        self.opened, self.number, self.fails = 0, 0, False

    def open(self) -> None:
        self.opened += 1

    def newest(self) -> Picture:
        if self.fails:
            self.fails = False
            raise DeviceFault("its cable is out")
        self.number += 1
        return Picture(rgb=np.zeros((48, 64, 3), np.uint8), number=self.number, time=time.monotonic())

    def close(self) -> None:
        pass


def test_a_camera_that_comes_back_is_connected_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcs.envs.ports.camera_thread.RECONNECT", 0.01)
    pictures = Counted()
    camera = VideoCamera("webcam", CameraMode(64, 48, 100.0, False), pictures, {})
    feed = CameraFeedThread("side", camera, lambda frame: {"number": frame.number})
    feed.start()
    feed.wait(time.monotonic() + 20.0)
    pictures.fails = True
    end = time.monotonic() + 20.0
    while not feed.reconnections:
        assert time.monotonic() < end
        time.sleep(0.01)
    assert not camera.fault
    assert pictures.opened == 2
    feed.close()
