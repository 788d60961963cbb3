"""The driver keeps the contract of grippers, over its wire, and an environment uses it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from line_gripper.driver import LineGripper, LineGripperDriver
from line_gripper.virtual import VirtualGripper

import rcs
from rcs.errors import DeviceFault, InvalidSetup
from rcs.robots import FRANKA_HAND
from rcs.testing import GripperContract


@pytest.fixture
def virtual() -> Iterator[VirtualGripper]:
    virtual = VirtualGripper()
    yield virtual
    virtual.close()


class TestTheGripper(GripperContract):
    """All clauses of the contract, with the faults that the virtual gripper has."""

    @pytest.fixture(autouse=True)
    def _connect(self, virtual: VirtualGripper) -> None:
        self.virtual = virtual

    def make_device(self) -> LineGripper:
        """Return a new gripper, not opened."""
        return LineGripper(self.virtual.address, FRANKA_HAND)

    def lose_link(self, device: Any) -> None:
        """Cut the cable."""
        self.virtual.cut()

    def restore_link(self, device: Any) -> None:
        """Mend the cable."""
        self.virtual.mend()

    def is_energised(self, device: Any) -> bool:
        """Return whether the motor is on."""
        return self.virtual.is_powered


def test_its_own_fault_is_met_in_its_own_words(virtual: VirtualGripper) -> None:
    with LineGripper(virtual.address, FRANKA_HAND) as gripper:
        virtual.trip("the motor is hot")
        with pytest.raises(DeviceFault, match="the motor is hot"):
            gripper.command_opening(0.0)
        gripper.recover()
        gripper.command_opening(0.0)


def test_an_environment_opens_and_closes_it(virtual: VirtualGripper) -> None:
    hardware = {"fr3": "fake", "fr3/gripper": f"line_gripper.driver:LineGripperDriver:{virtual.address}"}
    with rcs.make("Free", robot="fr3", hardware=hardware) as env:
        observation, _ = env.reset()
        for _ in range(30):
            observation, *_ = env.step({"joints": np.zeros(7), "gripper": np.zeros(1)})
        assert observation["gripper"] == pytest.approx(0.0, abs=0.01)


def test_what_it_cannot_use_is_refused_with_what_is_valid() -> None:
    driver = LineGripperDriver()
    with pytest.raises(InvalidSetup, match="HOST:PORT"):
        driver.gripper("", FRANKA_HAND, {})
    with pytest.raises(InvalidSetup, match="speed"):
        driver.gripper("127.0.0.1", FRANKA_HAND, {"speed": 1})
    with pytest.raises(DeviceFault, match="no gripper answers"), driver.gripper("127.0.0.1:9", FRANKA_HAND, {}):
        pass
