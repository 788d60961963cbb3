"""Parts of environments that the tests share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from rcs.devices import ArmLimits
from rcs.devices.fakes import FakeArm, FakeGripper
from rcs.envs.control_layers import layers_of
from rcs.envs.env import Env
from rcs.envs.ports.port import ArmPort, EffectorPort
from rcs.envs.setup import Setup
from rcs.envs.spaces import Control
from rcs.envs.step.chain import Chain
from rcs.envs.step.clock import Clock
from rcs.envs.step.stack import Stack
from rcs.kinematics import kinematics_of
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.sim.scene import RobotPlacement


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

    def __init__(
        self,
        *,
        is_synchronous: bool = False,
        max_episode_steps: int | None = 20,
        robots: tuple[str, ...] = (),
        control: Control = "joints",
        is_relative: bool = True,
    ) -> None:
        """Make one robot, or several by name."""
        self.clock = HandClock()
        self.setup = Setup(task="Free", control=control, relative=is_relative)
        self.arms: list[FakeArm] = []
        self.grippers: list[FakeGripper] = []
        stacks = [self._make_robot(f"{name} " if name else "") for name in robots or ("",)]
        stack = Stack(dict(zip(robots, stacks, strict=True)) if robots else stacks[0])
        clock = Clock(
            ports=stack.ports, frequency=30.0, is_synchronous=is_synchronous, now=self.clock, sleep=self.clock.sleep
        )
        self.arm, self.gripper = self.arms[0], self.grippers[0]
        self.env = Env(stack, clock, setup=self.setup, max_episode_steps=max_episode_steps)

    def _make_robot(self, prefix: str) -> Chain:
        limits = ArmLimits(list(FR3.joint_lower), list(FR3.joint_upper), list(FR3.velocity_limit))
        arm = FakeArm(limits, start=np.array(FR3.home), clock=self.clock, name=f"{prefix}fake arm")
        gripper = FakeGripper(clock=self.clock, name=f"{prefix}fake gripper")
        self.arms.append(arm)
        self.grippers.append(gripper)
        placement = RobotPlacement(name=prefix or "fr3", arm=FR3, gripper=FRANKA_HAND)
        ports = [ArmPort(arm, kinematics_of(FR3, FRANKA_HAND)), EffectorPort(gripper)]
        return Chain(ports, layers_of(self.setup, placement))


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def make_bench() -> Callable[..., Bench]:
    return Bench
