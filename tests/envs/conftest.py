"""Parts of environments that the tests share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from rcs.devices import ArmLimits
from rcs.devices.fakes import FakeArm, FakeGripper
from rcs.envs.clock import WallClock
from rcs.envs.env import Env
from rcs.envs.layers import BinaryGripper, LimitStep, Relative
from rcs.envs.ports import ArmPort, GripperPort
from rcs.envs.stack import Stack
from rcs.kinematics import kinematics_of
from rcs.robots.fr3.description import FR3
from rcs.robots.franka_hand.description import FRANKA_HAND


class HandClock:
    """A clock that tests move by hand [s]."""

    def __init__(self) -> None:
        self.now = 100.0
        self.slept: list[float] = []

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now += seconds


class Bench:
    """An environment on fake devices, with the parts at hand."""

    def __init__(self, *, is_synchronous: bool = False, max_episode_steps: int | None = 20) -> None:
        self.clock = HandClock()
        limits = ArmLimits(list(FR3.joint_lower), list(FR3.joint_upper), list(FR3.velocity_limit))
        self.arm = FakeArm(limits, start=np.array(FR3.home), clock=self.clock)
        self.gripper = FakeGripper(clock=self.clock)
        ports = [ArmPort(self.arm, kinematics_of(FR3, FRANKA_HAND)), GripperPort(self.gripper)]
        step = np.array(FR3.velocity_limit) / 30
        layers = [LimitStep(step), Relative("joints", max_joint_step=step), BinaryGripper()]
        clock = WallClock(ports, frequency=30.0, is_synchronous=is_synchronous, now=self.clock, sleep=self.clock.sleep)
        self.env = Env(Stack(ports, layers), clock, max_episode_steps=max_episode_steps)


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def make_bench() -> Callable[..., Bench]:
    return Bench
