"""Ways of an arm between joints, and what a guard admits of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from rcs.envs import Env
from rcs.robots.fr3 import FR3

OPEN = np.ones(1, np.float32)
HOME = np.array(FR3.home)
DOWN = np.array([0, 1.3, 0, -0.35, 0, 0.95, 0])
"""From home through the table, the fingers first [rad]."""


def ask(env: Env, start: Any, goal: Any) -> Mapping[str, Any]:
    """Return what the guard admits of a way between joints."""
    guard: Any = env.stack.gates[0]
    env.simulation.robots[0].put(np.array(start))
    measured = {"": {"joints": np.array(start), "gripper": OPEN}}
    guard.reset(measured, ...)
    return guard.admit({"": {"joints": np.array(goal), "gripper": OPEN}}, measured)
