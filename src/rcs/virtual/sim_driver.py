"""A driver of simulated devices, which stand in for a missing robot, with its delay and noise."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from rcs.devices import lookup
from rcs.devices.fakes import FakeGripper
from rcs.hardware.driver import Driver
from rcs.hardware.fake import FakeDriver
from rcs.robots.description import ArmDescription, GripperDescription
from rcs.virtual.stand_in_arm import StandInArm, StandInOptions


class SimDriver(Driver):
    """Driver of arms with real-time physics, and of grippers that move at the speeds of their descriptions.

    An arm takes the options of `StandInOptions`, a gripper none.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Set the clock [s]; pass one that you advance yourself to run faster than real time."""
        super().__init__()
        self._clock = clock

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> StandInArm:
        """Return an arm at its home position."""
        given = StandInOptions.from_json(options)
        gripper: GripperDescription | None = None if given.gripper is None else lookup.find("gripper", given.gripper)
        return StandInArm(
            about,
            gripper=gripper,
            delay=given.delay,
            noise=given.noise,
            seed=given.seed,
            smoothing=given.smoothing,
            clock=self._clock,
            name=address or about.name,
        )

    def gripper(self, address: str, about: GripperDescription, options: Mapping[str, Any]) -> FakeGripper:
        """Return an open gripper, which cannot grasp."""
        return FakeDriver(self._clock).gripper(address, about, options)
