"""Devices written in Python that fail: in a call, while they open, close, hold or recover, and in what they measure."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from rcs.devices import (
    ArmLimits,
    ArmState,
)
from rcs.errors import DeviceFault, InvalidAction, MissingDependency, WrongOrder
from tests.devices.scripted_arm import Scripted


@pytest.mark.parametrize("call", ["open", "state", "command_joints", "has_arrived", "hold", "close"])
def test_what_a_driver_raises_is_a_fault_in_its_words(limits: ArmLimits, call: str) -> None:
    arm = Scripted(limits, **{call: IndexError("list index out of range")})
    arguments = (np.zeros(3),) if call == "command_joints" else ()
    if call != "open":
        arm.open()
    with pytest.raises(DeviceFault, match=f"scripted: {call} failed: IndexError: list index out of range") as caught:
        getattr(arm, call)(*arguments)
    assert caught.value.__cause__ is arm.answers[call]
    if call != "open":
        assert arm.fault == f"{call} failed: IndexError: list index out of range"
        assert "hold" in arm.calls
        arm.close()


def test_a_fault_that_a_driver_raises_is_told_as_it_says(limits: ArmLimits) -> None:
    raised = DeviceFault("joint 3 is above 60 degrees")
    arm = Scripted(limits, state=raised)
    with arm:
        with pytest.raises(DeviceFault, match="scripted: joint 3 is above 60 degrees") as caught:
            arm.state()
        assert caught.value.__cause__ is raised
        assert arm.fault == "joint 3 is above 60 degrees"


class Mute(Exception):
    """An exception that fails to say what it is."""

    def __str__(self) -> str:
        raise ValueError("no words")


@pytest.mark.parametrize("call", ["open", "state", "hold", "recover", "close"])
@pytest.mark.parametrize(
    ("error", "text"),
    [
        (Mute(), "Mute: (its text cannot be shown)"),
        (OSError("no file \ud800"), r"OSError: no file \ud800"),
        (DeviceFault("no file \ud800"), r"no file \ud800"),
    ],
)
def test_an_exception_whose_message_is_no_text_is_a_fault_all_the_same(
    limits: ArmLimits, call: str, error: Exception, text: str
) -> None:
    arm = Scripted(limits, **{call: error})
    if call != "open":
        arm.open()
    with pytest.raises(DeviceFault, match=re.escape(text)) as caught:
        getattr(arm, call)()
    assert caught.value.__cause__ is error
    arm.answers.clear()
    arm.close()


@pytest.mark.parametrize(
    "error", [KeyboardInterrupt(), SystemExit(3), MissingDependency("no such library"), InvalidAction("too far")]
)
@pytest.mark.parametrize("call", ["open", "state", "command_joints", "hold", "recover", "close"])
def test_ctrl_c_and_errors_of_ours_are_no_faults(limits: ArmLimits, call: str, error: BaseException) -> None:
    arm = Scripted(limits, **{call: error})
    if call != "open":
        arm.open()
    if call == "recover":
        arm.set_fault("collision")
    with pytest.raises(type(error)) as caught:
        getattr(arm, call)(*[np.zeros(3)] * (call == "command_joints"))
    assert caught.value is error
    assert arm.fault == ("collision" if call == "recover" else "")
    arm.answers.clear()
    arm.close()


def test_what_failed_to_open_is_closed_and_can_be_opened_again(limits: ArmLimits) -> None:
    arm = Scripted(limits, open=OSError("unplugged"))
    with pytest.raises(DeviceFault, match="open failed: OSError: unplugged"):
        arm.open()
    assert arm.calls == ["open", "close"]
    assert not arm.is_open
    with pytest.raises(WrongOrder):
        arm.state()
    arm.answers.clear()
    with arm:
        assert arm.fault == ""


@pytest.mark.parametrize("call", ["hold", "close"])
def test_an_arm_that_failed_to_close_is_closed_and_let_go_of(limits: ArmLimits, call: str) -> None:
    arm = Scripted(limits, **{call: OSError("unplugged")})
    arm.open()
    with pytest.raises(DeviceFault, match=f"{call} failed: OSError: unplugged"):
        arm.close()
    assert not arm.is_open
    assert arm.calls[-1] == "close"
    arm.close()


def test_an_arm_whose_fault_is_known_closes_without_a_word(limits: ArmLimits) -> None:
    arm = Scripted(limits, state=OSError("unplugged"), hold=OSError("unplugged"), close=OSError("unplugged"))
    with arm, pytest.raises(DeviceFault, match="state failed: OSError: unplugged"):
        arm.state()
    assert not arm.is_open
    assert arm.fault == "state failed: OSError: unplugged"
    assert arm.calls == ["open", "state", "hold", "hold", "close"]


class Reporting(Scripted):
    """An arm that finds in its `_hold` that the link is lost."""

    def _hold(self) -> None:
        self.set_fault("the link is lost")
        super()._hold()


def test_a_hold_that_sets_a_fault_ends(limits: ArmLimits) -> None:
    arm = Reporting(limits, hold=OSError("no route"))
    with arm:
        with pytest.raises(DeviceFault, match="hold failed: OSError: no route"):
            arm.hold()
        assert arm.fault == "the link is lost"
        arm.set_fault("another")
        assert arm.fault == "the link is lost; hold failed: OSError: no route"
    assert arm.calls == ["open", "hold", "hold", "hold", "close"]


def test_a_hold_that_fails_is_added_to_the_reason_of_the_fault(limits: ArmLimits) -> None:
    arm = Scripted(limits, hold=OSError("unplugged"))
    arm.open()
    arm.set_fault("collision")
    assert arm.fault == "collision; hold failed: OSError: unplugged"
    arm.close()


def test_a_hold_that_fails_does_not_hide_a_bad_measurement(limits: ArmLimits) -> None:
    arm = Scripted(limits, hold=OSError("unplugged"), state=ArmState([0.0], [0.0], 0.0))
    arm.open()
    with pytest.raises(DeviceFault, match="measured 1 joints, it has 3; hold failed: OSError: unplugged"):
        arm.state()


@pytest.mark.parametrize("call", ["hold", "recover"])
def test_a_fault_whose_recovery_fails_stays_and_the_error_says_so(limits: ArmLimits, call: str) -> None:
    arm = Scripted(limits)
    arm.open()
    arm.set_fault("collision")
    arm.answers[call] = TimeoutError("no answer within 10 ms")
    with pytest.raises(
        DeviceFault, match=r"recover failed: TimeoutError: no answer within 10 ms; the fault stays \(collision\)"
    ) as caught:
        arm.recover()
    assert caught.value.__cause__ is arm.answers[call]
    assert arm.fault == "collision"
    with pytest.raises(DeviceFault, match="collision"):
        arm.command_joints(np.zeros(3))
    arm.answers.clear()
    arm.recover()
    assert arm.fault == ""


@pytest.mark.parametrize(
    ("state", "text"),
    [
        (ArmState([0.0, 0.0], [0.0, 0.0], 0.0), "measured 2 joints, it has 3"),
        (ArmState([0.0, math.nan, 0.0], [0.0] * 3, 0.0), "not finite at joint 1"),
        (ArmState([0.0] * 3, [0.0, 0.0, math.inf], 0.0), "not finite at joint 2"),
    ],
)
def test_a_measurement_that_makes_no_sense_is_a_fault_and_the_arm_holds(
    limits: ArmLimits, state: ArmState, text: str
) -> None:
    arm = Scripted(limits, state=state)
    arm.open()
    with pytest.raises(DeviceFault, match=text):
        arm.state()
    assert arm.calls == ["open", "state", "hold"]
    with pytest.raises(DeviceFault, match="recover"):
        arm.command_joints(np.zeros(3))
