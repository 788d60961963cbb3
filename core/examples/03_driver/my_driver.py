"""Makes arms of `my_arm.cpp` for sites and `rcs.make`, as `hardware={"ur5e": "my_driver:MyDriver:192.0.2.1", …}`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from my_arm import MyArm  # what CMake has built, on the path

from rcs.devices import Arm, ArmLimits
from rcs.errors import InvalidSetup, require_fields
from rcs.hardware import Driver
from rcs.robots.description import ArmDescription


class MyDriver(Driver):
    """Reaches arms by IP address."""

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> Arm:
        """Return an arm with the limits of a description; the option `speed` is a share of its joint speeds."""
        require_fields("option of my arm", options, ("speed",))
        speed = options.get("speed", 1.0)
        if not isinstance(speed, int | float) or not 0 < speed <= 1:
            raise InvalidSetup(f"speed of my arm is {speed!r}; valid is a share above 0 and at most 1.")
        limits = ArmLimits(
            about.joint_lower,
            about.joint_upper,
            [speed * fastest for fastest in about.velocity_limit],
            about.acceleration_limit,
            about.jerk_limit,
        )
        return MyArm(address, limits, about.home)
