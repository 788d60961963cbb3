"""The contract of the cameras of tactile sensors, as tests."""

from __future__ import annotations

import numpy as np
import pytest

from rcs.devices import Camera
from rcs.robots.tactile import DIGIT, TactileDescription
from rcs.testing.camera_contract import CameraContract


class TactileContract(CameraContract):
    """Checks a tactile sensor, with nothing on its gel."""

    sensor: TactileDescription = DIGIT
    """Description of the sensor."""
    trace: float = 0.5
    """Mean difference of pixels that a press must make [of 255]."""

    def press(self, device: Camera) -> None:
        """Press something into the gel; override it where a test can."""
        pytest.skip("override press to test what the sensor feels")

    def release(self, device: Camera) -> None:
        """Take it away again."""

    def test_frames_are_those_of_the_description(self) -> None:
        """So that a real sensor takes the place of a simulated one."""
        with self.open_device() as sensor:
            mode = sensor.mode
            assert (mode.width, mode.height) == self.sensor.frame_size
            assert mode.fps <= self.sensor.rate
            assert not mode.has_depth

    def test_the_lights_are_on(self) -> None:
        """A dark gel shows nothing."""
        with self.open_device() as sensor:
            assert sensor.read().rgb.mean() > 5

    def test_a_press_is_seen_and_goes_away(self) -> None:
        """It changes the picture by more than noise, and the picture comes back."""
        with self.open_device() as sensor:
            free = sensor.read().rgb.astype(float)
            self.press(sensor)
            self.advance(3.0 / sensor.mode.fps)
            pressed = sensor.read().rgb.astype(float)
            assert np.abs(pressed - free).mean() > self.trace
            self.release(sensor)
            self.advance(3.0 / sensor.mode.fps)
            again = sensor.read().rgb.astype(float)
            assert np.abs(again - free).mean() < np.abs(pressed - free).mean()
