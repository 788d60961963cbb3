"""Leading arms of several drivers, and waiting for what comes of it."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rcs.devices import Arm
from rcs.errors import DeviceFault
from rcs.robots import FR3

PERIOD = 1 / 30


def wait_until(is_so: Callable[[], object], seconds: float = 5.0) -> None:
    until = time.monotonic() + seconds
    while not is_so():
        assert time.monotonic() < until, "it has not happened"
        time.sleep(0.002)


def wait_for_fault(arm: Arm, seconds: float = 3.0) -> str:
    wait_until(lambda: arm.fault != "", seconds)
    return arm.fault


def is_measured(arm: Arm) -> bool:
    try:
        arm.state()
    except DeviceFault:
        return False
    return True


def lead(arm: Arm, target: NDArray[np.float64]) -> None:
    """Lead an arm to a target, and wait until it is there."""
    if np.abs(target - arm.state().joints).max() > 0.19:
        arm.command_joints(arm.state().joints)
        time.sleep(0.3)  # until it is led: only a first target must be near
    arm.command_joints(target)
    wait_until(lambda: arm.fault != "" or arm.has_arrived(), 10.0)
    assert arm.fault == ""


def stream(arm: Arm, targets: NDArray[np.float64]) -> NDArray[np.float64]:
    """Send targets at 30 Hz, and return what was measured when each came."""
    measured: list[NDArray[np.float64]] = []
    for target in targets:
        arm.command_joints(target, valid_for=1.0)
        time.sleep(PERIOD)
        measured.append(arm.state().joints)
    return np.array(measured)


def wave(arm: Arm, amplitude: float = 0.15, seconds: float = 2.0) -> NDArray[np.float64]:
    """Return targets of an FR3 to and fro, and first towards the home pose."""
    times, joints = np.arange(0.0, seconds, PERIOD)[:, None], arm.state().joints
    return joints + amplitude * 0.5 * (1 - np.cos(np.pi * times)) * np.where(joints < FR3.home, 1, -1)
