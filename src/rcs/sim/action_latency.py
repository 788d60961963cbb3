"""Delays everything that servos are told, by whole physics steps, with MuJoCo's own history of controls.

The history is part of the simulation's state, so that a state holds what is still on its way.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.sim.layout import RobotLayout
from rcs.sim.model_rows import ModelRows
from rcs.sim.scene import RobotPlacement
from rcs.sim.world import Copies, World


def keep_history(spec: mujoco.MjSpec, robots: Sequence[RobotPlacement], longest: float) -> None:
    """Make room for late controls of robots in a scene, before it is compiled.

    Args:
        spec: The scene.
        robots: Its robots.
        longest: Longest latency [s].
    """
    samples = int(np.ceil(longest / spec.option.timestep)) + 2
    for robot in robots:
        effector: tuple[str, ...] = ()
        if robot.gripper is not None:
            effector = (robot.gripper.actuator,)
        elif robot.hand is not None:
            effector = robot.hand.actuators
        names = [robot.prefix + name for name in robot.arm.actuators]
        for name in [*names, *(robot.gripper_prefix + name for name in effector)]:
            spec.actuator(name).nsample = samples


class ActionLatency:
    """The latency of all robots of a world; with one of 0, servos get what they are told at once."""

    def __init__(self, world: World, robots: Sequence[RobotPlacement]) -> None:
        """Look the robots up in a world whose scene was given to `keep_history`."""
        model = world.model
        layouts = [RobotLayout.of(robot, model) for robot in robots]
        arms = [i for one in layouts for i in (*one.actuator_ids, *one.hand_actuator_ids)]
        self._ids = [*arms, *(one.finger_actuator for one in layouts if one.finger_actuator >= 0)]
        self._world = world
        self._step = float(model.opt.timestep)
        self._delays = ModelRows(world, "actuator_delay", self._ids)
        # Where the history of each actuator has its values, which lie among the times of when they were given.
        self._slots = [_slots(model, i) for i in self._ids]

    def whole_steps(self, latency: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the nearest latencies that are whole physics steps [s]."""
        return np.round(latency / self._step) * self._step

    def write(self, latency: NDArray[np.float64], copies: Copies = None) -> None:
        """Set the latency of some copies [s], in whole physics steps, (*leading of these, 1)."""
        # Half a step less, since MuJoCo rounds up, and times that are sums of steps are not exact.
        delay = np.maximum(latency - 0.5 * self._step, 0.0)
        self._delays.write(np.broadcast_to(delay, (*delay.shape[:-1], len(self._ids))), copies)

    def settle(self, copies: Copies = None) -> None:
        """Make the present controls of some copies those that were always given."""
        ctrl = self._world.ctrl
        history = self._history()
        for actuator, slots in zip(self._ids, self._slots, strict=True):
            if copies is None:
                history[..., slots] = ctrl[..., actuator, None]
            else:
                history[np.ix_(copies, slots)] = ctrl[copies, actuator, None]

    def _history(self) -> NDArray[np.float64]:
        if self._world.data is not None:
            return self._world.data.history
        return self._world.core.component(mujoco.mjtState.mjSTATE_HISTORY.value)


def _slots(model: mujoco.MjModel, actuator: int) -> NDArray[np.intp]:
    """Return where in the history of a state the values of an actuator are: where other values make a difference."""
    data = mujoco.MjData(model)
    samples = int(model.actuator_history[actuator, 0])
    filled: list[NDArray[np.float64]] = []
    for value in (1.0, 2.0):
        mujoco.mj_initCtrlHistory(model, data, actuator, None, np.full((samples, 1), value))
        filled.append(np.array(data.history))
    return np.flatnonzero(filled[0] != filled[1])
