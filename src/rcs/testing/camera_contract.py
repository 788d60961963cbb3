"""The contract of cameras, as tests."""

from __future__ import annotations

import time

import numpy as np
import pytest

from rcs.devices import Camera, Frame
from rcs.errors import DeviceFault
from rcs.testing.device_contract import DeviceContract


class CameraContract(DeviceContract[Camera]):
    """Checks a camera."""

    rate_tolerance: float = 0.2
    """By which share the measured rate may differ from that of the mode."""
    read_limit: float = 1.5
    """Longest time that a read, or closing, may take, whatever the camera does [s]."""
    clock_tolerance: float = 0.05
    """By how much the host's and the device's clock may differ in one second [s]."""

    def measure(self, device: Camera) -> Frame:
        """Return the newest frame."""
        return device.read()

    def test_a_frame_has_the_size_of_the_mode(self) -> None:
        """Colours always, depth when the mode has it."""
        with self.open_device() as camera:
            frame, mode = camera.read(), camera.mode
            assert (frame.rgb.shape, frame.rgb.dtype) == ((mode.height, mode.width, 3), np.uint8)
            if frame.depth_mm is not None:
                assert (frame.depth_mm.shape, frame.depth_mm.dtype) == ((mode.height, mode.width), np.uint16)
            assert (frame.depth_mm is not None) == mode.has_depth

    def test_a_frame_never_changes(self) -> None:
        """Its arrays are read-only views of one memory, also while the camera goes on."""
        with self.open_device() as camera:
            frame = camera.read()
            kept = frame.rgb.copy()
            assert np.shares_memory(frame.rgb, frame.rgb)
            with pytest.raises(ValueError, match="read-only"):
                frame.rgb[:] = 0
            for _ in range(3):
                self.advance(2.0 / camera.mode.fps)
                camera.read()
            np.testing.assert_array_equal(frame.rgb, kept)

    def test_a_later_frame_has_a_higher_number_and_a_later_time(self) -> None:
        """The same number is the same frame."""
        with self.open_device() as camera:
            first = camera.read()
            again = camera.read()
            if again.number == first.number:
                assert again.time == first.time
                np.testing.assert_array_equal(again.rgb, first.rgb)
            self.advance(2.0 / camera.mode.fps)
            second = camera.read()
            assert second.number > first.number
            assert second.time > first.time

    def test_frames_come_at_the_rate_of_the_mode(self) -> None:
        """Counted over half a second."""
        with self.open_device() as camera:
            first = camera.read()
            self.advance(0.5)
            second = camera.read()
            expected = 0.5 * camera.mode.fps
            assert abs(second.number - first.number - expected) <= 1 + self.rate_tolerance * expected

    def test_a_calibration_is_a_camera_matrix_or_unknown(self) -> None:
        """With the centre of projection inside of the picture, nearly always."""
        with self.open_device() as camera:
            calibration, mode = camera.calibration, camera.mode
            if calibration is not None:
                (fx, _, cx), (_, fy, cy), last = calibration.matrix
                assert min(fx, fy) > 0
                assert 0 < cx < mode.width
                assert 0 < cy < mode.height
                np.testing.assert_array_equal(last, [0.0, 0.0, 1.0])
                assert np.isfinite(calibration.distortion).all()

    # --- Times --------------------------------------------------------------------------------------------------------

    def test_a_frame_is_neither_from_the_future_nor_old(self) -> None:
        """Its time is on the host's monotonic clock."""
        with self.open_device() as camera:
            for _ in range(5):
                frame = camera.read()
                age = time.monotonic() - frame.time
                assert 0.0 <= age <= self.max_age
                self.advance(1.0 / camera.mode.fps)

    def test_after_a_pause_the_newest_frame_comes_first(self) -> None:
        """Not one that has waited in a buffer."""
        with self.open_device() as camera:
            first = camera.read()
            self.advance(1.0)
            begin = time.monotonic()
            second = camera.read()
            assert begin - second.time <= self.max_age
            assert second.number - first.number >= 0.5 * camera.mode.fps

    def test_the_devices_clock_counts_the_same_frames(self) -> None:
        """Where it has one: the same number has the same time, and the rate of both is that of the mode."""
        with self.open_device() as camera:
            first, second = self._by_its_clock(camera, 0.5)
            passed = second.device_time - first.device_time
            expected = (second.number - first.number) / camera.mode.fps
            assert passed > 0
            assert abs(passed - expected) <= 1.5 / camera.mode.fps + self.rate_tolerance * expected

    def test_both_clocks_agree_on_how_long_it_took(self) -> None:
        """A picture that comes late keeps its own time."""
        if type(self).advance is not DeviceContract.advance:
            pytest.skip("on a simulated clock, the host's does not go on")
        with self.open_device() as camera:
            first, second = self._by_its_clock(camera, 1.0)
            passed = second.device_time - first.device_time
            assert abs(second.time - first.time - passed) <= self.clock_tolerance * max(passed, 1.0)

    def _by_its_clock(self, camera: Camera, seconds: float) -> tuple[Frame, Frame]:
        """Return two frames, so far apart; skip the test of a camera that has no clock."""
        first = camera.read()
        if not np.isfinite(first.device_time):
            pytest.skip("the camera has no clock of its own")
        self.advance(seconds)
        return first, camera.read()

    # --- Calls that end -----------------------------------------------------------------------------------------------

    def test_reads_and_closing_end_in_time(self) -> None:
        """Also the first read after opening."""
        with self.open_device() as camera:
            for _ in range(5):
                begin = time.monotonic()
                camera.read()
                assert time.monotonic() - begin <= self.read_limit
                self.advance(1.0 / camera.mode.fps)
            begin = time.monotonic()
            camera.close()
            assert time.monotonic() - begin <= self.read_limit

    def test_a_read_without_the_link_ends_in_time(self) -> None:
        """With a fault, and never with a picture from before."""
        with self.open_device() as camera:
            camera.read()
            self.lose_link(camera)
            begin = time.monotonic()
            with pytest.raises(DeviceFault):
                self._read_until_lost(camera)
            assert time.monotonic() - begin <= self.read_limit + self.max_age
            begin = time.monotonic()
            camera.close()
            assert time.monotonic() - begin <= self.read_limit

    def test_a_camera_that_is_back_shows_what_is_there_now(self) -> None:
        """With higher numbers and later times than before."""
        with self.open_device() as camera:
            before = camera.read()
            self.lose_link(camera)
            lost = time.monotonic()
            with pytest.raises(DeviceFault):
                self._read_until_lost(camera)
            self.restore_link(camera)
            self.advance(2.0 / camera.mode.fps)
            camera.recover()
            after = camera.read()
            assert after.number > before.number
            assert after.time >= lost - 1.0 / camera.mode.fps

    def _read_until_lost(self, camera: Camera) -> None:
        """Read what was under way when the link was cut."""
        for _ in range(10):
            camera.read()

    # --- Properties ---------------------------------------------------------------------------------------------------

    def test_depth_is_measured_somewhere(self) -> None:
        """Where the mode has it; 0 is no reading."""
        with self.open_device() as camera:
            depth = camera.read().depth_mm
            if depth is None:
                pytest.skip("the mode has no depth")
            assert depth.max() > 0

    def test_it_is_the_same_camera_when_it_is_opened_again(self) -> None:
        """The facts that it states of itself, such as its serial number, stay; so does its calibration."""
        with self.open_device() as camera:
            camera.read()
            first, seen = dict(getattr(camera, "about", {})), camera.calibration
            camera.close()
            camera.open()
            camera.read()
            assert dict(getattr(camera, "about", {})) == first
            again = camera.calibration
            assert (again is None) == (seen is None)
            if again is not None and seen is not None:
                np.testing.assert_array_equal(again.matrix, seen.matrix)
