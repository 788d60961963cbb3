"""Ages of measurements: an answer that a library repeats after the cable is out must not look new."""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import NDArray

from rcs.devices import Arm, ArmState, Gripper, GripperState, Hand, HandState

LEAD = 0.1
"""An arm without a clock whose target has moved by this [rad], while not one number changed, repeats its last answer.

An arm that stands still may well measure the same again and again: encoders count in steps.
"""


class Freshness:
    """Knows when a device last measured something new, and sets its fault when that is too long ago.

    A repeat shows in the device's own clock, `device_time`, which stands still, or in the age that its driver gives,
    `time`. An arm that has neither is known to repeat when its target moves and nothing else does.
    """

    def __init__(self, device: Arm | Gripper | Hand, stale_after: float = math.inf) -> None:
        """Watch a device.

        Args:
            device: The device.
            stale_after: Age of what it measures from which it is in its fault state [s].
        """
        self.time = 0.0
        """When what was measured last was new [s, monotonic clock of the host]."""
        self._device = device
        self._stale_after = stale_after
        self._mark: float | bytes | None = None
        self._target: NDArray[np.float64] | None = None
        self._was_led = False

    def judge(self, state: ArmState | GripperState | HandState, target: NDArray[np.float64] | None = None) -> None:
        """Look at what was measured; the device is in its fault state after it if that is too old.

        Args:
            state: Measurement of the device.
            target: Last target of an arm [rad], shape (dof,); None before the first.
        """
        has_clock = math.isfinite(state.device_time)
        mark = state.device_time if has_clock else _numbers(state)
        if mark is None or mark != self._mark:
            self._mark, self._target, self.time, self._was_led = mark, target, state.time, False
        elif not has_clock and not self._was_led:  # the age counts from here
            self.time, self._was_led = state.time, self._is_led(target)
        age = time.monotonic() - self.time
        if age > self._stale_after and not self._device.fault:
            self._device.set_fault(
                f"nothing new measured for {age:.2f} s, more than {self._stale_after:g} s; look at the cable and at "
                "the controller"
            )

    def _is_led(self, target: NDArray[np.float64] | None) -> bool:
        """Return whether the target has moved away since a number changed."""
        if target is None or self._target is None:
            self._target = target
            return False
        return bool(np.abs(target - self._target).max() > LEAD)


def _numbers(state: ArmState | GripperState | HandState) -> bytes | None:
    """Return all that an arm without a clock measures; None of a gripper or hand, which stand still on an object."""
    if not isinstance(state, ArmState):
        return None
    measured = (state.joints, state.joint_velocities, state.efforts, state.wrench)
    return b"".join(np.asarray(one).tobytes() for one in measured)
