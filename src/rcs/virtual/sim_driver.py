"""A driver of simulated devices, which stand in for a missing robot, with its delay and noise."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from rcs.devices import lookup
from rcs.devices.fakes import FakeGripper
from rcs.errors import require_fields
from rcs.hardware.driver import Driver
from rcs.hardware.fake import FakeDriver
from rcs.robots.description import ArmDescription, GripperDescription
from rcs.virtual.stand_in_arm import StandInArm

OPTIONS = ("delay", "noise", "seed", "smoothing", "gripper")


class SimDriver(Driver):
    """Driver of arms with real-time physics, and of grippers that move at the speeds of their descriptions.

    Options of an arm in a site: `delay` [s], `noise` [rad], `seed`, `smoothing` [s], and `gripper`, the name of its
    gripper.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Set the clock [s]; pass one that you advance yourself to run faster than real time."""
        super().__init__()
        self._clock = clock

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> StandInArm:
        """Return an arm at its home position."""
        require_fields("option of a simulated arm", options, OPTIONS)
        given = dict(options)
        name = given.pop("gripper", None)
        gripper: GripperDescription | None = None if name is None else lookup.find("gripper", name)
        return StandInArm(about, gripper=gripper, clock=self._clock, name=address or about.name, **given)

    def gripper(self, address: str, about: GripperDescription, options: Mapping[str, Any]) -> FakeGripper:
        """Return an open gripper, which cannot grasp; it ignores the options of its arm."""
        require_fields("option of a simulated arm", options, OPTIONS)
        return FakeDriver(self._clock).gripper(address, about, {})
