"""Write your own device: an arm in Python behind the device interface, controlled by the same environment.

An arm overrides a few functions with a leading underscore. The interface checks everything else: the order of calls,
finite targets within the limits, and a fault state that only `recover` clears. On a real robot, the functions call the
vendor's library; here, a velocity-limited motion replaces it.

The gripper has no device here, so it is simulated together with the arm, in real time.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

import rcs
from rcs.devices import Arm, ArmLimits, ArmState
from rcs.robots import FR3


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


with rcs.make("Free", robot="fr3", control="xyzrpy", frequency=50, hardware={"fr3": MyArm()}) as env:
    print(env)
    print(env.limits())
    observation, info = env.reset()
    start, first = time.perf_counter(), observation["tquat"]
    for _ in range(25):
        action = {"xyzrpy": np.array([0.0, 0.002, 0.0, 0.0, 0.0, 0.0]), "gripper": np.array([0.0])}
        observation, reward, terminated, truncated, info = env.step(action)
    print("the TCP moved by", (observation["tquat"] - first)[:3].round(3), "m")
    print(f"25 steps at {env.frequency:g} Hz took {time.perf_counter() - start:.2f} s; each part is {env.platform}")
