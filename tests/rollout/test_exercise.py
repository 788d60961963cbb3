"""The contract on the arms of a lab, slowly: good ones keep it, and each way of not keeping it is found and held."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
import pytest

import rcs
from rcs.devices.fakes import FakeArm
from rcs.hardware import FakeDriver, Site
from rcs.robots.description import ArmDescription
from rcs.rollout import exercise
from rcs.rollout.exercise import move

SETUP = rcs.Setup(task="Free", end_effector=None)


class Odd(FakeArm):
    """An arm with one bad habit."""

    habit: ClassVar[str] = ""
    made: ClassVar[list[Odd]] = []

    def _open(self) -> None:
        super()._open()
        if self.habit == "starts":
            self._command_joints(np.array(self.body.values) + 0.05)

    def _command_joints(self, joints: Any) -> None:
        if self.habit == "is off":
            joints = np.array(joints) + 0.03
        if self.habit == "jumps":
            joints = np.array(joints) + np.where(np.arange(7) == 2, 0.5, 0.0) * self.is_under_way(joints)
        if self.habit == "falls silent" and self.is_under_way(joints):
            self.lose_link()
        super()._command_joints(joints)

    def is_under_way(self, joints: Any) -> bool:
        return bool(np.abs(np.array(joints) - rcs.robots.FR3.home).max() > 1e-3)

    def _hold(self) -> None:
        super()._hold()
        if self.habit == "holds badly":
            self.body.target = self.body.values = np.array(rcs.robots.FR3.home) + self.inwards * 0.05

    @property
    def inwards(self) -> np.ndarray:
        middle = (np.array(self.limits.joint_lower) + np.array(self.limits.joint_upper)) / 2
        return np.where(np.array(rcs.robots.FR3.home) < middle, 1.0, -1.0)

    def _has_arrived(self) -> bool:
        return self.habit != "never arrives" and super()._has_arrived()


class OddDriver(FakeDriver):
    def arm(self, address: str, about: ArmDescription, options: Mapping[str, Any]) -> FakeArm:
        plain = super().arm(address, about, options)
        arm = Odd(plain.limits, start=np.array(about.home), name="arm")
        Odd.made.append(arm)
        return arm


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Odd, "habit", "")
    monkeypatch.setattr(Odd, "made", [])
    monkeypatch.setattr(exercise, "RESTING", 0.1)


def moved(habit: str = "", *, agrees: bool = True) -> Any:
    Odd.habit = habit
    (found,) = move(Site(arms={"fr3": f"{__name__}:OddDriver:a"}), SETUP, lambda _: agrees)
    return found


def test_a_good_arm_keeps_every_clause_and_is_where_it_was() -> None:
    began = time.monotonic()
    found = moved()
    assert (found.part, found.status) == ("fr3", "ok")
    assert found.message.startswith("9 clauses of the contract kept")
    assert time.monotonic() - began > 4 * 0.05 / (0.05 * max(rcs.robots.FR3.velocity_limit))  # to and fro, slowly
    (arm,) = Odd.made
    assert not arm.is_open
    np.testing.assert_allclose(arm.body.values, rcs.robots.FR3.home, atol=1e-3)


@pytest.mark.parametrize(
    ("habit", "words"),
    [
        ("starts", "opening moves nothing: it is 0.0"),
        ("is off", "a command to where it is moves nothing: it is 0.030 rad off"),
        ("jumps", "it comes to its target and says so: joint 3 moved by"),
        ("holds badly", "hold stops it on its way: it went on to its target"),
        ("falls silent", "it comes to its target and says so: "),
        ("never arrives", "it comes to its target and says so: it is there and does not say so"),
    ],
)
def test_an_arm_that_does_not_is_held_at_the_first_clause(habit: str, words: str) -> None:
    found = moved(habit)
    assert found.status == "fault"
    assert words in found.message
    assert "brakes" in found.remedy
    assert not Odd.made[0].is_open


def test_nothing_moves_when_nobody_agrees() -> None:
    found = moved(agrees=False)
    assert found.status == "warning"
    assert "Move every joint of fr3 by 0.05 rad to and fro" in found.message
    assert not Odd.made
