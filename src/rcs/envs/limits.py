"""The limits of the motion of an environment's robots, to be read before anything moves."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rcs.envs.layers.limits import LimitStep
from rcs.envs.ports.port import ArmPort
from rcs.envs.step.stack import NAMELESS, Stack
from rcs.sim.scene import RobotPlacement


@dataclass(frozen=True, kw_only=True)
class RobotLimits:
    """Limits of one robot, (dof,) each."""

    joint_lower: NDArray[np.float64]
    """Lowest joint targets [rad]."""
    joint_upper: NDArray[np.float64]
    """Highest joint targets [rad]."""
    joint_velocity: NDArray[np.float64]
    """Largest joint speeds of the robot and its device [rad/s]."""
    target_velocity: NDArray[np.float64]
    """Largest speeds at which targets may move [rad/s]; infinite where nothing bounds them."""


@dataclass(frozen=True)
class Limits:
    """Limits of all robots and the gates that every action must pass. `print` shows them as a table."""

    robots: Mapping[str, RobotLimits]
    gates: tuple[str, ...]

    def __str__(self) -> str:
        """Return a line per joint."""
        lines = [f"{'joint':16}{'lowest':>9}{'highest':>9} rad {'robot':>9}{'targets':>9} rad/s"]
        for name, own in self.robots.items():
            rows = zip(own.joint_lower, own.joint_upper, own.joint_velocity, own.target_velocity, strict=True)
            for i, (lower, upper, speed, target) in enumerate(rows, start=1):
                lines.append(f"{f'{name} {i}':16}{lower:9.3f}{upper:9.3f}     {speed:9.2f}{target:9.2f}")
        return "\n".join([*lines, f"gates: {', '.join(self.gates) or 'none'}"])


def limits_of(robots: Mapping[str, RobotPlacement], stack: Stack, frequency: float) -> Limits:
    """Return the limits that hold in a stack.

    Args:
        robots: Descriptions by name.
        stack: Ports, layers and gates.
        frequency: Control steps per second [Hz].
    """
    found: dict[str, RobotLimits] = {}
    for name, robot in robots.items():
        chain = stack.chains.get(name) or stack.chains[NAMELESS]
        box = chain.joint_space
        assert box is not None, "a robot has an arm"
        bounds = [*chain.layers, *(port.limit for port in chain.ports if isinstance(port, ArmPort))]
        steps = [bound.max_step for bound in bounds if isinstance(bound, LimitStep)]
        slowest = np.min(steps, axis=0) * frequency if steps else np.full(box.shape, np.inf)
        found[name] = RobotLimits(
            joint_lower=box.low.astype(np.float64),
            joint_upper=box.high.astype(np.float64),
            joint_velocity=np.array(robot.arm.velocity_limit),
            target_velocity=slowest,
        )
    return Limits(found, tuple(map(str, stack.gates)))
