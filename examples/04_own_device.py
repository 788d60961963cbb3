"""A robot of your own: an arm written in Python behind the device interface, driven through the same environment.

An arm overrides a few functions with a leading underscore. Everything around them is checked by the interface: calls
in a wrong order, targets that are not finite or outside the limits, and a fault state that only `recover` clears. On a
real robot the functions talk to the vendor's library; here a velocity-limited motion stands in for it.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from rcs.devices import Arm, ArmLimits, ArmState
from rcs.devices.fakes import FakeGripper
from rcs.envs.chain import Chain
from rcs.envs.clock import Clock
from rcs.envs.env import Env
from rcs.envs.layers import BinaryGripper, CartesianControl, LimitStep, Relative
from rcs.envs.ports import ArmPort, GripperPort
from rcs.envs.stack import Stack
from rcs.kinematics import kinematics_of
from rcs.robots.fr3.description import FR3
from rcs.robots.franka_hand.description import FRANKA_HAND

FREQUENCY = 50.0  # Hz


class MyArm(Arm):
    """Moves to its target at no more than a fifth of the largest joint velocities."""

    def __init__(self) -> None:
        """Stand at home; nothing is connected yet."""
        super().__init__("my arm", ArmLimits(FR3.joint_lower, FR3.joint_upper, FR3.velocity_limit))
        self._joints = np.array(FR3.home)
        self._target = self._joints.copy()
        self._time = time.monotonic()

    def _advance(self) -> None:
        now = time.monotonic()
        reach = 0.2 * np.array(FR3.velocity_limit) * (now - self._time)
        self._joints = self._joints + np.clip(self._target - self._joints, -reach, reach)
        self._time = now

    def _state(self) -> ArmState:
        self._advance()
        return ArmState(list(self._joints), [0.0] * 7, self._time)

    def _command_joints(self, joints: NDArray[np.float64]) -> None:
        self._advance()
        self._target = joints

    def _has_arrived(self) -> bool:
        self._advance()
        return bool(np.abs(self._target - self._joints).max() < 1e-4)

    def _hold(self) -> None:
        self._advance()
        self._target = self._joints.copy()


kinematics = kinematics_of(FR3, FRANKA_HAND)
ports = [ArmPort(MyArm(), kinematics), GripperPort(FakeGripper())]
max_step = 0.2 * np.array(FR3.velocity_limit) / FREQUENCY
layers = [LimitStep(max_step), CartesianControl(kinematics), Relative("xyzrpy"), BinaryGripper()]
env = Env(Stack(Chain(ports, layers)), Clock(ports=ports, frequency=FREQUENCY), title="my robot")
print(env)

observation, info = env.reset()
start = time.perf_counter()
first = observation["tquat"]
for _ in range(25):
    action = {"xyzrpy": np.array([0.0, 0.002, 0.0, 0.0, 0.0, 0.0]), "gripper": np.array([0.0])}
    observation, reward, terminated, truncated, info = env.step(action)
print("the TCP moved by", (observation["tquat"] - first)[:3].round(3), "m")
print(f"25 steps at {FREQUENCY:g} Hz took {time.perf_counter() - start:.2f} s")
env.close()
