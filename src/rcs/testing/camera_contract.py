"""The contract of cameras, as tests."""

from __future__ import annotations

import numpy as np
import pytest

from rcs.devices import Camera, Frame
from rcs.testing.device_contract import DeviceContract


class CameraContract(DeviceContract[Camera]):
    """Checks a camera."""

    rate_tolerance: float = 0.2
    """By which share the measured rate may differ from that of the mode."""

    def make_camera(self) -> Camera:
        """Return a new camera, not opened. To be overridden."""
        raise NotImplementedError("override make_camera and return a new camera that is not opened")

    def make_device(self) -> Camera:
        """Return a new camera."""
        return self.make_camera()

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
