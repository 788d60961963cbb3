"""The driver of our arm: `rcs.make("PushToLine", robot="my_robot", hardware="my_driver:192.0.2.7")`.

There is no controller yet, so fake devices replace it. `04_own_device.py` shows the functions that an arm
overrides for a real one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rcs.devices import Arm, ArmLimits, FakeArm, FakeGripper, Gripper
from rcs.hardware import Driver
from rcs.robots import ArmDescription, GripperDescription


class MyDriver(Driver):
    """Driver of our arm and its gripper at the address of a controller."""

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> Arm:
        """Return the arm, not connected."""
        limits = ArmLimits(about.joint_lower, about.joint_upper, about.velocity_limit)
        return FakeArm(limits, start=np.array(about.home), name=f"my robot at {address}")

    def gripper(self, address: str, about: GripperDescription, options: Mapping[str, Any]) -> Gripper:
        """Return the gripper, not connected."""
        return FakeGripper(max_width=about.max_width, max_force=about.max_force, name=f"gripper at {address}")
