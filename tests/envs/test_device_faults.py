"""A failure in a driver ends the episode in its words; leaving the environment raises nothing then."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.devices import ArmState
from rcs.devices.fakes import FakeArm, FakeGripper
from rcs.envs.env import Env
from rcs.errors import DeviceFault
from rcs.robots import FR3

STAY = {"joints": np.zeros(7), "gripper": np.array([1.0])}


class Glitching(FakeArm):
    """An arm whose library fails in one of its calls as vendors' libraries do."""

    def __init__(self) -> None:
        super().__init__(FR3.arm_limits, start=np.array(FR3.home), name="glitching")
        self.failing = ""

    def _fail(self, call: str) -> None:
        if call == self.failing:
            raise IndexError("list index out of range")

    def _open(self) -> None:
        self._fail("open")
        super()._open()

    def _state(self) -> ArmState:
        self._fail("state")
        return super()._state()

    def _command_joints(self, joints: Any) -> None:
        self._fail("command_joints")
        super()._command_joints(joints)


def made(arm: FakeArm, gripper: FakeGripper | None = None) -> Env:
    hardware = {"fr3": arm, "fr3/gripper": gripper or FakeGripper()}
    return rcs.make("Free", robot="fr3", hardware=hardware, frequency=60)


@pytest.mark.parametrize("call", ["state", "command_joints"])
def test_an_error_of_a_vendors_library_ends_the_episode_in_its_words(call: str) -> None:
    arm, gripper = Glitching(), FakeGripper()
    with made(arm, gripper) as env:
        env.reset()
        env.step(STAY)
        arm.failing = call
        _, _, terminated, truncated, info = env.step({"joints": np.full(7, 0.02), "gripper": np.array([0.0])})
        assert (terminated, truncated, info["end"]) == (False, True, "fault")
        assert info["faults"] == {"glitching": f"{call} failed: IndexError: list index out of range"}
        assert gripper.has_arrived()  # it holds, with all others
        assert {"time", "late", "ages", "target"} <= info.keys()  # as after any other step in real time
        arm.failing = ""
        env.recover()
        env.reset()
        env.step(STAY)


def test_an_error_as_a_device_opens_leaves_none_open() -> None:
    arm, gripper = Glitching(), FakeGripper()
    arm.failing = "open"
    with made(arm, gripper) as env:
        with pytest.raises(DeviceFault, match="glitching: open failed: IndexError: list index out of range"):
            env.reset()
        assert not arm.is_open
        assert not gripper.is_open
        arm.failing = ""
        env.reset()
        env.step(STAY)


def test_an_environment_is_left_quietly_after_a_lost_link_that_was_told() -> None:
    arm = Glitching()
    with made(arm) as env:
        env.reset()
        arm.lose_link()
        *_, truncated, info = env.step(STAY)
        assert truncated
        assert "the link is lost" in info["faults"]["glitching"]
    assert not arm.is_open


def test_a_lost_link_that_nobody_was_told_of_is_told_on_leaving() -> None:
    arm = Glitching()
    env = made(arm)
    env.reset()
    arm.lose_link()
    with pytest.raises(DeviceFault, match="glitching: the link is lost"):
        env.close()
    assert not arm.is_open
    env.close()
