"""What every camera must do, as tests."""

from __future__ import annotations

import time
from collections.abc import Generator
from contextlib import contextmanager

import numpy as np
import pytest

from rcs.devices import Camera
from rcs.errors import DeviceFault, WrongOrder
from rcs.testing.arm_contract import in_a_thread


class CameraContract:
    """Checks a camera."""

    rate_tolerance: float = 0.2
    """By which share the measured rate may differ from that of the mode."""

    def make_camera(self) -> Camera:
        """Return a new camera, not opened. To be overridden."""
        raise NotImplementedError("override make_camera and return a new camera that is not opened")

    def advance(self, seconds: float) -> None:
        """Let time pass; override it for a camera on a simulated clock."""
        time.sleep(seconds)

    @contextmanager
    def open_camera(self) -> Generator[Camera]:
        """Give an open camera and close it in the end."""
        camera = self.make_camera()
        camera.open()
        try:
            yield camera
        finally:
            camera.close()

    def test_a_camera_is_closed_and_without_fault_when_it_is_made(self) -> None:
        """Making a camera connects nothing."""
        camera = self.make_camera()
        assert not camera.is_open
        assert camera.fault == ""
        assert camera.mode.fps > 0

    def test_a_closed_camera_gives_no_frames(self) -> None:
        """Before it is opened, and after it was closed."""
        camera = self.make_camera()
        with pytest.raises(WrongOrder):
            camera.read()
        camera.open()
        camera.close()
        assert not camera.is_open
        with pytest.raises(WrongOrder):
            camera.read()

    def test_closing_is_harmless_twice_and_before_opening(self) -> None:
        """As often as one likes."""
        camera = self.make_camera()
        camera.close()
        camera.open()
        camera.read()
        camera.close()
        camera.close()
        assert not camera.is_open

    def test_a_frame_has_the_size_of_the_mode(self) -> None:
        """Colours always, depth when the mode has it."""
        with self.open_camera() as camera:
            frame, mode = camera.read(), camera.mode
            pixels = mode.width * mode.height
            assert frame.rgb.shape == (pixels, 3)
            assert frame.rgb.dtype == np.uint8
            assert frame.depth_mm.shape == (pixels if mode.has_depth else 0,)
            assert frame.depth_mm.dtype == np.uint16

    def test_writing_to_a_frame_changes_nothing(self) -> None:
        """Neither the same frame when it is asked again, nor the next."""
        with self.open_camera() as camera:
            frame = camera.read()
            kept = frame.rgb.copy()
            frame.rgb[:] = 255 - frame.rgb
            np.testing.assert_array_equal(frame.rgb, kept)
            camera.read()
            np.testing.assert_array_equal(frame.rgb, kept)

    def test_numbers_and_times_of_frames_ascend(self) -> None:
        """A later frame has a higher number and a later time."""
        with self.open_camera() as camera:
            first = camera.read()
            self.advance(2.0 / camera.mode.fps)
            second = camera.read()
            assert second.number > first.number
            assert second.time > first.time

    def test_frames_come_at_the_rate_of_the_mode(self) -> None:
        """Counted over half a second."""
        with self.open_camera() as camera:
            first = camera.read()
            self.advance(0.5)
            second = camera.read()
            expected = 0.5 * camera.mode.fps
            assert abs(second.number - first.number - expected) <= 1 + self.rate_tolerance * expected

    def test_a_fault_stays_until_recover(self) -> None:
        """It keeps its first reason."""
        with self.open_camera() as camera:
            camera.set_fault("the first reason")
            camera.set_fault("another reason")
            for _ in range(2):
                with pytest.raises(DeviceFault, match="the first reason"):
                    camera.read()
            camera.recover()
            assert camera.fault == ""
            camera.read()

    def test_a_fault_is_read_and_set_from_another_thread(self) -> None:
        """By whoever watches the connection."""
        with self.open_camera() as camera:

            def watch() -> None:
                assert camera.is_open
                assert camera.fault == ""
                camera.set_fault("watchdog")

            in_a_thread(watch)
            assert camera.fault == "watchdog"
            with pytest.raises(DeviceFault, match="watchdog"):
                camera.read()
            camera.recover()
            camera.read()

    def test_recover_needs_an_open_camera(self) -> None:
        """There is nothing to recover before."""
        with pytest.raises(WrongOrder):
            self.make_camera().recover()
