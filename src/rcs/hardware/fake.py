"""A driver of fake devices of every kind, which need no hardware and have the interfaces of real ones."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from rcs.devices import CameraMode
from rcs.devices.fakes import FakeArm, FakeCamera, FakeGripper, FakeHand
from rcs.errors import require_fields
from rcs.hardware.driver import Driver
from rcs.robots.camera import CameraDescription
from rcs.robots.description import ArmDescription, GripperDescription, HandDescription
from rcs.robots.tactile import TactileDescription


class FakeDriver(Driver):
    """Driver of devices that move at the speeds of their descriptions and measure without error; no options."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Set the clock [s]; pass one that you advance yourself to run faster than real time."""
        super().__init__()
        self._clock = clock

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> FakeArm:
        """Return an arm at its home position."""
        require_fields("option of a fake device", options, ())
        return FakeArm(about.arm_limits, start=np.array(about.home), clock=self._clock, name=address or about.name)

    def gripper(self, address: str, about: GripperDescription, options: Mapping[str, Any]) -> FakeGripper:
        """Return an open gripper."""
        require_fields("option of a fake device", options, ())
        return FakeGripper(
            max_width=about.max_width,
            max_force=about.max_force,
            speed=2.0 * about.closing_speed / about.max_width,
            clock=self._clock,
            name=address or about.name,
        )

    def hand(self, address: str, about: HandDescription, options: Mapping[str, Any]) -> FakeHand:
        """Return an open hand."""
        require_fields("option of a fake device", options, ())
        return FakeHand(len(about.joints), clock=self._clock, name=address or about.name)

    def camera(
        self, address: str, about: CameraDescription, mode: CameraMode, options: Mapping[str, Any]
    ) -> FakeCamera:
        """Return a camera that shows a moving ramp."""
        require_fields("option of a fake device", options, ())
        return FakeCamera(mode, clock=self._clock, name=address or about.name)

    def tactile(
        self, address: str, about: TactileDescription, mode: CameraMode, options: Mapping[str, Any]
    ) -> FakeCamera:
        """Return a sensor that shows a moving ramp."""
        require_fields("option of a fake device", options, ())
        return FakeCamera(mode, clock=self._clock, name=address or about.name)
