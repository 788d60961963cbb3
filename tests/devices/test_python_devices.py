"""Devices written in Python: what they do wrong is found, and what they raise is a fault in their words."""

from __future__ import annotations

import gc
import math
import subprocess
import sys
import weakref
from typing import Any

import numpy as np
import pytest

from rcs.devices import (
    Arm,
    ArmLimits,
    CameraMode,
    CommandKind,
    Device,
    Frame,
    GripperState,
    Hand,
    HandState,
    stop_all,
)
from rcs.errors import DeviceFault, InvalidAction, InvalidSetup
from rcs.spatial import Pose
from tests.devices.scripted_arm import Scripted
from tests.devices.test_python_grippers_and_cameras import RGB, Eye, Pincers


def test_calls_reach_the_device_in_order(limits: ArmLimits) -> None:
    arm = Scripted(limits)
    arm.open()
    arm.open()
    arm.command_joints(np.zeros(3))
    arm.recover()
    arm.close()
    arm.close()
    assert arm.calls == ["open", "command_joints", "recover", "hold", "hold", "close"]


@pytest.mark.parametrize(
    "limits",
    [
        ([], [], []),
        ([0.0], [1.0, 2.0], [1.0]),
        ([0.0], [1.0], [1.0, 1.0]),
        ([1.0], [0.0], [1.0]),
        ([0.0], [1.0], [0.0]),
        ([math.nan], [1.0], [1.0]),
        ([0.0], [1.0], [math.nan]),
    ],
)
def test_limits_that_make_no_sense_are_refused(limits: tuple[list[float], list[float], list[float]]) -> None:
    with pytest.raises(InvalidSetup, match="limits"):
        Scripted(ArmLimits(*limits))


def test_a_target_on_its_limit_that_went_through_float32_is_accepted(limits: ArmLimits) -> None:
    arm = Scripted(limits)
    arm.open()
    arm.command_joints(limits.joint_upper.astype(np.float32))


class Grasp(Hand):
    def __init__(self, answer: Any, joint_count: int = 2) -> None:
        super().__init__("grasp", joint_count)
        self.answer = answer

    def _state(self) -> HandState:
        return self.answer

    def _has_arrived(self) -> bool:
        return self.answer

    def _can_guide(self) -> bool:
        return self.answer

    def _hold(self) -> None:
        return


def ask(device: Device, name: str) -> object:
    attribute = getattr(device, name)
    return attribute() if callable(attribute) else attribute


@pytest.mark.parametrize(
    ("make", "call", "text"),
    [
        (
            lambda limits: Scripted(limits, state=[0.0, 0.0]),
            "state",
            r"_state returned \[0.0, 0.0\] of type list.*ArmState",
        ),
        (
            lambda limits: Scripted(limits, has_arrived=None),
            "has_arrived",
            "_has_arrived returned None of type NoneType.*bool",
        ),
        (
            lambda limits: Grasp(np.bool_(True)),
            "has_arrived",
            r"Grasp\._has_arrived returned .*True.* of type numpy\.bool.*, it must return a bool",
        ),
        (
            lambda limits: Grasp(GripperState(0.0, 0.0, 0.0)),
            "state",
            r"Grasp\._state returned .*GripperState, it must return a HandState",
        ),
        (lambda limits: Grasp(1), "can_guide", r"Grasp\._can_guide returned 1 of type int, it must return a bool"),
        (
            lambda limits: Eye(CameraMode(6, 4, 30.0), RGB),
            "read",
            "_read returned something of type numpy.ndarray, it must return a Frame",
        ),
    ],
)
def test_a_wrong_return_type_is_named_with_class_and_method(limits: ArmLimits, make: Any, call: str, text: str) -> None:
    device = make(limits)
    device.open()
    with pytest.raises(TypeError if call == "can_guide" else DeviceFault, match=text):
        ask(device, call)
    device.close()


class Half(Arm):
    """An arm whose author forgot the rest."""


def test_a_method_that_was_forgotten_is_named_with_its_class(limits: ArmLimits) -> None:
    with Half("half", limits) as arm, pytest.raises(DeviceFault, match=r"Half must define the method _state"):
        arm.state()


def test_every_device_is_a_device(limits: ArmLimits) -> None:
    devices: list[Device] = [
        Scripted(limits),
        Pincers(),
        Grasp(True),
        Eye(CameraMode(6, 4, 30.0), Frame(RGB, number=0)),
    ]
    for device in devices:
        device.open()
        device.set_fault("stop")
        assert device.fault == "stop"
        device.close()
        assert not device.is_open


def test_a_hand_of_two_billion_joints_refuses_a_target_before_it_makes_as_many_limits() -> None:
    hand = Grasp(True, joint_count=2**31 - 1)
    hand.open()
    with pytest.raises(InvalidAction, match="joints has 2 values, 2147483647 are needed"):
        hand.command_joints(np.zeros(2))


class Streamed(Scripted):
    """An arm that takes a pose and a twist besides joints, and forgot to override the torques that it names."""

    def __init__(self, limits: ArmLimits) -> None:
        Arm.__init__(self, "streamed", limits, {CommandKind.pose, CommandKind.twist, CommandKind.torques})
        self.answers, self.calls = {}, []

    def _command_pose(self, pose: Pose) -> None:
        self.calls.append(pose)

    def _command_twist(self, twist: Any) -> None:
        self.calls.append(list(twist))


def test_the_kinds_of_commands_that_an_arm_names_reach_it(limits: ArmLimits) -> None:
    arm = Streamed(limits)
    assert arm.commands() == {CommandKind.joints, CommandKind.pose, CommandKind.twist, CommandKind.torques}
    pose, twist = Pose.from_rpy([0.1, 0.2, 0.3], [0.4, 0.5, 0.6]), [0.1, 0.0, 0.0, 0.0, 0.0, 0.2]
    with arm:
        arm.command_pose(pose)
        arm.command_twist(np.array(twist), valid_for=10.0)
        with pytest.raises(InvalidAction, match="takes no velocities; it takes joints, pose, twist, torques"):
            arm.command_velocities(np.zeros(3))
        with pytest.raises(DeviceFault, match="Streamed must define the method _command_torques"):
            arm.command_torques(np.zeros(3))
    assert arm.calls[1:3] == [pose, twist]


def test_an_open_device_lives_until_it_is_closed(limits: ArmLimits) -> None:
    arm = Scripted(limits)
    seen = weakref.ref(arm)
    arm.open()
    del arm
    gc.collect()
    stop_all("nobody refers to it")
    arm = seen()
    assert arm is not None
    assert arm.fault == "nobody refers to it"
    arm.close()
    del arm
    gc.collect()
    assert seen() is None


def test_a_child_process_has_deadlines_of_its_own_and_none_of_its_parents_devices(limits: ArmLimits) -> None:
    # In a process of its own, for threads of other tests make a fork dangerous.
    program = """
import os, time
from rcs.devices import stop_all
from rcs.devices.fakes import FakeGripper
ours = FakeGripper(speed=0.01)
ours.open()
ours.command_opening(0.0, valid_for=0.01)
while not ours.has_arrived():
    time.sleep(0.001)
child = os.fork()
if child == 0:
    own = FakeGripper(speed=0.01)
    own.open()
    own.command_opening(0.0, valid_for=0.01)
    while not own.has_arrived():
        time.sleep(0.001)
    stop_all("child")
    os._exit(0 if own.fault == "child" and ours.fault == "" else 1)
assert os.waitpid(child, 0)[1] == 0
print("both held")
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout == "both held\n", done.stderr
