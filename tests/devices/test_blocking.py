"""While a device in C++ takes its time, everything else goes on."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from rcs.devices import ArmLimits
from rcs.errors import DeviceFault

pytestmark = pytest.mark.slow  # what it tests is compiled

CALLS: dict[str, Callable[[Any], object]] = {
    "open": lambda device: device.open(),
    "state": lambda arm: arm.state(),
    "command_joints": lambda arm: arm.command_joints(np.zeros(3)),
    "has_arrived": lambda arm: arm.has_arrived(),
    "recover": lambda arm: arm.recover(),
    "read": lambda camera: camera.read(),
    "close": lambda device: device.close(),
}


@pytest.fixture
def arm(blocking_devices: ModuleType, limits: ArmLimits) -> Any:
    return blocking_devices.BlockingArm(limits)


@pytest.fixture
def camera(blocking_devices: ModuleType) -> Any:
    return blocking_devices.BlockingCamera()


def require_others_to_run(device: Any, call: str) -> None:
    """Make a call that waits until another thread of Python lets it go."""
    if call != "open":
        device.open()
    device.gate.shut()
    thread = threading.Timer(0.05, device.gate.let_go)
    thread.start()
    CALLS[call](device)
    thread.join()
    assert device.gate.was_let_go


@pytest.mark.parametrize("call", ["open", "state", "command_joints", "has_arrived", "recover", "close"])
def test_other_threads_run_while_an_arm_waits(arm: Any, call: str) -> None:
    require_others_to_run(arm, call)


@pytest.mark.parametrize("call", ["open", "read", "close"])
def test_other_threads_run_while_a_camera_waits(camera: Any, call: str) -> None:
    require_others_to_run(camera, call)


def test_a_fault_is_set_and_read_while_a_measurement_waits(arm: Any) -> None:
    arm.open()
    arm.gate.shut()
    thread = threading.Thread(target=arm.state)
    thread.start()
    assert arm.is_open
    assert arm.fault == ""
    arm.set_fault("watchdog")
    assert arm.fault == "watchdog"
    arm.hold()
    assert thread.is_alive()
    arm.gate.let_go()
    thread.join()


def test_a_fault_that_comes_while_the_arm_recovers_is_kept(arm: Any) -> None:
    arm.open()
    arm.set_fault("collision")
    arm.gate.shut()
    watchdog = threading.Timer(0.05, lambda: (arm.set_fault("watchdog"), arm.gate.let_go()))
    watchdog.start()
    with pytest.raises(DeviceFault, match=r"a new fault came during recover \(watchdog\)"):
        arm.recover()
    assert arm.fault == "watchdog"


def test_a_command_that_was_under_way_when_a_fault_came_moves_nothing(arm: Any) -> None:
    arm.open()
    arm.gate.shut()
    caught: list[BaseException] = []

    def command() -> None:
        try:
            arm.command_joints(np.zeros(3))
        except DeviceFault as error:
            caught.append(error)

    thread = threading.Thread(target=command)
    thread.start()
    threading.Event().wait(0.05)
    arm.set_fault("stop")
    arm.gate.let_go()
    thread.join()
    assert not arm.is_moving
    assert "stop" in str(caught[0])
