"""A driver whose devices are simulated: it stands in for a robot that is not there, with its delay and its noise."""

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
    """Makes arms with physics that run in real time, and grippers that move at the speed of their descriptions.

    Options of an arm in a site: `delay` [s], `noise` [rad], `seed`, `smoothing` [s], and `gripper`, the name of what it
    carries.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Use a clock [s]; give one that is moved by hand to run faster than real time."""
        super().__init__()
        self._clock = clock

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> StandInArm:
        """Return an arm that stands at home."""
        require_fields("option of a simulated arm", options, OPTIONS)
        given = dict(options)
        name = given.pop("gripper", None)
        gripper: GripperDescription | None = None if name is None else lookup.find("gripper", name)
        return StandInArm(about, gripper=gripper, clock=self._clock, name=address or about.name, **given)

    def gripper(self, address: str, about: GripperDescription, options: Mapping[str, Any]) -> FakeGripper:
        """Return an open gripper, which grasps nothing; the options of its arm mean nothing to it."""
        require_fields("option of a simulated arm", options, OPTIONS)
        return FakeDriver(self._clock).gripper(address, about, {})
