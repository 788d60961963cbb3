from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.agents.action_writer import ActionWriter
from rcs.envs.env import Env
from rcs.envs.layers import CartesianControl, Layer, LimitStep, Relative
from rcs.envs.setup import Setup
from rcs.envs.spaces import JOINTS, TQUAT
from rcs.envs.step.chain import Chain
from rcs.envs.step.clock import Clock
from rcs.envs.step.stack import Stack
from rcs.kinematics import kinematics_of
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.spatial import distance


class Halve(Layer):
    """Lets the arm go only half of the way that is asked for."""

    def __init__(self) -> None:
        self._last: Any = None

    def reset(self, observation: Any, where: Any = ...) -> None:
        self._last = observation[JOINTS]

    def map_action(self, action: Any) -> Any:
        return {**action, JOINTS: (self._last + action[JOINTS]) / 2}

    def map_executed(self, executed: Any) -> Any:
        self._last = executed[JOINTS]
        return executed


@pytest.mark.parametrize("control", ["joints", "tquat"])
def test_an_arm_arrives_also_above_a_layer_that_halves_every_step(control: Any) -> None:
    setup = Setup(task="Free", control=control)
    made = rcs.make(setup)
    simulation = made.simulation
    kinematics = kinematics_of(FR3, FRANKA_HAND)
    layers: list[Layer] = [
        LimitStep(np.array(FR3.velocity_limit) / 30, np.array(FR3.motion_limits.lead(1 / 30))),
        Halve(),
    ]
    layers += [CartesianControl(kinematics)] if control == TQUAT else []
    layers += [Relative(control, frequency=30.0, joint_speed=FR3.velocity_limit)]
    env = Env(Stack(Chain(made.stack.ports, layers)), Clock(simulation.world), simulation)
    observation, info = env.reset(seed=0)
    writer = ActionWriter(setup, env.stack.action_space, kinematics)
    writer.reset(observation)
    goal = np.array(observation[TQUAT])
    goal[:3] += [-0.05, 0.1, 0.08]
    for _ in range(60):
        writer.follow(info)
        action = writer.write(goal, 1.0)
        assert action is not None
        observation, _, _, _, info = env.step(action)
    translation, rotation = distance(observation[TQUAT], goal)
    assert translation < 2e-3
    assert rotation < 1e-2
