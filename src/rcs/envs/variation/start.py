"""Starts of robots: around home, within their limits, and free of collisions."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.sim.robot import RobotLayout, SimRobot
from rcs.sim.scene import TABLE, RobotPlacement
from rcs.sim.world import Copies

if TYPE_CHECKING:  # the randomiser calls this module
    from rcs.envs.variation.randomiser import Randomiser, Values

TRIES = 16
"""Deviations that are drawn for each start; the first one without a collision counts, or home."""
CLEARANCES = (0.10, 0.08, 0.06, 0.04, 0.02, 0.0)
"""Height above the table that a start keeps free [m], for objects: the first of these that home keeps free."""


class VariedStart:
    """Draws starts of all robots of a world, and puts robots there."""

    def __init__(self, vary: Randomiser, robots: Sequence[RobotPlacement]) -> None:
        """Enable the fields of a robot's start, if their ranges have a width."""
        self._vary = vary
        arms = [robot.arm for robot in robots]
        joints = [robot.prefix + name for robot in robots for name in robot.arm.joints]
        self._sizes = np.cumsum([0, *(arm.dof for arm in arms)])
        most = vary.ranges.robot_start
        if vary.ranges.varies("robot_start") and joints:
            free = _FreeSpace(vary, robots)
            home = np.concatenate([arm.home for arm in arms])
            low = np.maximum(np.concatenate([arm.joint_lower for arm in arms]) - home, -most)
            high = np.minimum(np.concatenate([arm.joint_upper for arm in arms]) - home, most)
            draws = np.tile(low, (TRIES, 1)), np.tile(high, (TRIES, 1))
            vary.enable("robot_start", joints, bounds=draws, finish=free.first)
        self._jaws = [robot.name for robot in robots if robot.gripper is not None]
        vary.enable("gripper_opening", self._jaws)

    def place(self, robots: Sequence[SimRobot], copies: Copies = None) -> None:
        """Put the robots of some copies where their present episodes start, by writing the state."""
        drawn = {
            field: values if copies is None else values[copies]
            for field, values in self._vary.values.items()
            if field in ("robot_start", "gripper_opening")
        }
        if not drawn:
            return
        for i, robot in enumerate(robots):
            leading = next(iter(drawn.values())).shape[:-1]
            joints = np.broadcast_to(np.array(robot.placement.arm.home), (*leading, robot.placement.arm.dof))
            if "robot_start" in drawn:
                joints = joints + drawn["robot_start"][..., self._sizes[i] : self._sizes[i + 1]]
            opening = None
            if "gripper_opening" in drawn and robot.placement.name in self._jaws:
                jaw = self._jaws.index(robot.placement.name)
                opening = drawn["gripper_opening"][..., jaw : jaw + 1]
            robot.put(joints, opening, copies=copies)


class _FreeSpace:
    """Finds contacts of robots in a scene without objects and with a higher table.

    They depend on the robots' joints alone, whatever else varies.
    """

    def __init__(self, vary: Randomiser, robots: Sequence[RobotPlacement]) -> None:
        world = vary.world
        self._model = copy.copy(world.model)
        self._data = mujoco.MjData(self._model)
        model = self._model
        is_robots = np.zeros(model.nbody, np.bool_)
        for robot in robots:
            is_robots |= world.subtree(robot.base_body)
        ignored = ~is_robots[model.geom_bodyid] & (model.body_weldid[model.geom_bodyid] != 0)
        model.geom_contype[ignored] = model.geom_conaffinity[ignored] = 0
        model.flex_contype[:] = model.flex_conaffinity[:] = 0
        layouts = [RobotLayout.of(robot, model) for robot in robots]
        self._qpos = np.concatenate([model.jnt_qposadr[one.joint_ids] for one in layouts]).astype(np.intp)
        self._home = np.concatenate([robot.arm.home for robot in robots])
        for robot, one in zip(robots, layouts, strict=True):
            if robot.gripper is not None:
                self._data.qpos[one.finger_qpos] = robot.gripper.joint_open
            if robot.hand is not None:
                lower, upper = np.array(robot.hand.joint_lower), np.array(robot.hand.joint_upper)
                self._data.qpos[one.hand_qpos] = lower + np.array(robot.hand.open_pose) * (upper - lower)
        self._usual: frozenset[tuple[int, int]] = frozenset()
        self._usual = self._touching(self._home)
        table = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, TABLE)
        if table >= 0:
            lowest = float(model.body_pos[table, 2])
            for clearance in CLEARANCES:
                model.body_pos[table, 2] = lowest + clearance
                if self._touching(self._home) <= self._usual:
                    break

    def first(self, deviations: Values) -> Values:
        """Return for each start the first of its deviations that touches nothing that home does not touch.

        Args:
            deviations: From home [rad], (..., tries, joints).

        Returns:
            One for each, (..., joints); zeros where all touch something.
        """
        rows = deviations.reshape(-1, *deviations.shape[-2:])
        chosen = np.zeros((len(rows), rows.shape[-1]))
        for row, own in zip(chosen, rows, strict=True):
            for deviation in own:
                if self._touching(self._home + deviation) <= self._usual:
                    row[:] = deviation
                    break
        return chosen.reshape(*deviations.shape[:-2], -1)

    def _touching(self, joints: NDArray[np.float64]) -> frozenset[tuple[int, int]]:
        """Return the pairs of bodies that touch."""
        self._data.qpos[self._qpos] = joints
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        if not self._data.ncon:
            return frozenset()
        geoms = self._data.contact.geom[self._data.contact.dist < 0.0]
        bodies = np.sort(self._model.geom_bodyid[geoms], axis=-1)
        return frozenset((int(one), int(other)) for one, other in bodies)
