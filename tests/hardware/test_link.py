"""Arm and gripper of one robot share one connection: opened by the first, closed by the last, used by one at a time."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.devices import ArmState, GripperState
from rcs.devices.fakes import FakeArm, FakeGripper
from rcs.errors import WrongOrder
from rcs.hardware import Driver, Link
from rcs.robots.description import ArmDescription, GripperDescription


class Line:
    """A connection that takes one call at a time and answers slowly."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.is_open = True
        self.calls = 0
        self.inside = 0

    def ask(self) -> None:
        assert self.is_open
        self.calls += 1
        self.inside += 1
        time.sleep(1e-3)
        assert self.inside == 1, "two threads at once"
        self.inside -= 1

    def close(self) -> None:
        assert self.is_open
        self.is_open = False


class LinkedArm(FakeArm):
    link: Link[Line]

    def _open(self) -> None:
        self.link.open(self)

    def _close(self) -> None:
        self.link.close(self)

    def _state(self) -> ArmState:
        with self.link as line:
            line.ask()
        return super()._state()


class LinkedGripper(FakeGripper):
    link: Link[Line]

    def _open(self) -> None:
        self.link.open(self)

    def _close(self) -> None:
        self.link.close(self)

    def _state(self) -> GripperState:
        with self.link as line:
            line.ask()
        return super()._state()


class LineDriver(Driver):
    """Reaches arm and gripper over one line per address."""

    lines: list[Line]

    def __init__(self) -> None:
        super().__init__()
        self.lines = made
        self.lines.clear()

    def _line(self, address: str) -> Link[Line]:
        return self.link(address, lambda: self._connect(address), Line.close)

    def _connect(self, address: str) -> Line:
        self.lines.append(Line(address))
        return self.lines[-1]

    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> LinkedArm:
        arm = LinkedArm(about.arm_limits, start=np.array(about.home), name=f"arm {address}")
        arm.link = self._line(address)
        return arm

    def gripper(self, address: str, about: GripperDescription, options: Mapping[str, Any]) -> LinkedGripper:
        gripper = LinkedGripper(name=f"gripper {address}")
        gripper.link = self._line(address)
        return gripper


made: list[Line] = []
"""The lines of the last driver."""


def test_arm_and_gripper_of_a_robot_share_a_connection_and_two_robots_do_not() -> None:
    name = f"{__name__}:LineDriver"
    with rcs.make("Free", robot="dual_fr3", hardware={"left": f"{name}:a", "right": f"{name}:b"}) as env:
        assert made == [], "nothing is connected before reset"
        env.reset(seed=0)
        assert [line.address for line in made] == ["a", "b"]
        assert all(line.calls >= 2 for line in made)
    assert [line.is_open for line in made] == [False, False]


def test_the_last_device_closes_the_connection_and_another_open_makes_a_new_one() -> None:
    driver = LineDriver()
    arm, gripper = LinkedArm(rcs.robots.FR3.arm_limits), LinkedGripper()
    arm.link = gripper.link = driver._line("a")
    with pytest.raises(WrongOrder, match="before a device has opened"), arm.link:
        pass
    arm.open()
    gripper.open()
    arm.close()
    arm.close()
    assert made[0].is_open
    gripper.state()
    gripper.close()
    assert not made[0].is_open
    gripper.open()
    assert len(made) == 2
    gripper.close()


def test_a_device_that_has_not_opened_the_connection_does_not_close_it_for_others() -> None:
    driver = LineDriver()
    arm, gripper = LinkedArm(rcs.robots.FR3.arm_limits), LinkedGripper()
    arm.link = gripper.link = driver._line("a")
    gripper.open()
    arm.link.close(arm)
    assert made[0].is_open
    gripper.close()


def test_one_thread_at_a_time_uses_a_connection() -> None:
    driver = LineDriver()
    gripper = LinkedGripper()
    gripper.link = driver._line("a")
    gripper.open()
    failures: list[AssertionError] = []

    def ask() -> None:
        try:
            for _ in range(10):
                with gripper.link as line:
                    line.ask()
        except AssertionError as err:
            failures.append(err)

    threads = [threading.Thread(target=ask) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    assert made[0].calls == 30
    gripper.close()
