"""The part that tasks share in which a robot carries a cuboid to a place, sets it down and lets go of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from rcs_data.options import Positive

from rcs.envs.layers import CopyIndex
from rcs.envs.task import Judgement, Task
from rcs.sim.robot import SimRobot
from rcs.sim.world import World
from rcs.spatial import compose
from rcs.tasks.holding import TOUCH_FORCE, Grip, HoldTimer, all_but
from rcs.tasks.lifting import nearness, norm

MAX_TILT = np.deg2rad(5.0)
"""Tilt above which a cuboid does not count as lying flat [rad]."""
STIR = 0.002
"""Distance that a cuboid may move while it counts as at rest [m]."""
HAND_OVER = 0.03
"""Distance from its goal at which the gripper may still let go of a cuboid [m]: beyond, it is dropped or thrown."""


class RestOptions(Task.Options):
    """Options of a task of setting something down."""

    rest_time: Positive = 0.5
    """How long the object must lie at its goal at rest, without a break [s], in simulated time."""


class Delivery:
    """Judges in each copy whether a robot has carried an object to its goal, set it down there and let go of it."""

    memory = ("_grip", "_rest", "_height", "_was_lifted", "_was_delivered")

    def __init__(
        self, world: World, robots: Sequence[SimRobot], name: str, *, on: str, at: str, rest_time: float
    ) -> None:
        """Register forces and poses for readout.

        Args:
            world: The world, before its first step.
            robots: The one robot, which has a gripper.
            name: Name of the object's body and of its geom.
            on: Name of the body on which it belongs.
            at: Name of the body above whose origin it belongs.
            rest_time: How long it must lie there [s].
        """
        robot, core = robots[0], world.core
        surface = world.geom_flags([name])
        self._world = world
        self._name = name
        self._grip = Grip(world, robots, name)
        self._rest = HoldTimer(world, rest_time, STIR, places=1)
        self._on = core.read_force(world.subtree_flags(on), surface)
        self._elsewhere = core.read_force(all_but(world, on, name), surface)
        self._touched = core.read_force(world.subtree_flags(robot.placement.base_body), surface)
        own, other = (int(world.model.body(body).id) for body in (name, at))
        self._object, self._at = (core.read_body_pose(body, 0) for body in (own, other))
        self._object_in_base, self._at_in_base = (
            core.read_body_pose(body, robot.layout.base_body) for body in (own, other)
        )
        self._tcp = core.read_pose(robot.layout.tcp_site, 0)
        self._height: NDArray[np.float64] = np.zeros((*world.leading, 1))
        """Height of the goal above the origin of `at` [m]."""
        self._was_lifted: NDArray[np.bool_] = np.zeros(world.leading, np.bool_)
        """Whether the object was in the gripper, and touched nothing else, at least once."""
        self._was_delivered: NDArray[np.bool_] = np.zeros(world.leading, np.bool_)
        """Whether it was near its goal when the gripper held it last, after it had been lifted."""

    def reset(self, where: CopyIndex, height: NDArray[np.float64]) -> None:
        """Start again for some copies, with the heights of all goals above `at` [m]."""
        self._grip.reset()
        self._rest.reset(where)
        self._height = height[..., None].copy()
        self._was_lifted, self._was_delivered = np.array(self._was_lifted), np.array(self._was_delivered)
        self._was_lifted[where] = self._was_delivered[where] = False

    def _goal(self, at: int) -> NDArray[np.float64]:
        up = np.zeros((*self._world.leading, 7))
        up[..., 2:3], up[..., 6] = self._height, 1.0
        return compose(self._world.poses[..., at, :], up)

    def seen(self) -> dict[str, NDArray[np.float64]]:
        """Return the poses of the object and of its goal in the robot's base frame."""
        cuboid = self._world.poses[..., self._object_in_base, :].copy()
        return {self._name: cuboid, "goal": self._goal(self._at_in_base)}

    def judge(self, tolerance: float, is_ready: NDArray[np.bool_] | np.bool_ = np.True_) -> Judgement:
        """Judge the present state of all copies.

        Progress has nine parts: reaching, lifting, setting down at the goal and letting go there have one each,
        grasping has two, and carrying to the goal after lifting three. A held object counts by how upright it is: an
        object that tipped over is hard to set down.

        Args:
            tolerance: Horizontal distance from the goal within which the object may lie [m].
            is_ready: Whether the body below is as it should be, (*leading,).
        """
        poses, forces = self._world.poses, self._world.forces
        pose = poses[..., self._object, :]
        offset = pose[..., :3] - self._goal(self._at)[..., :3]
        distance = norm(offset)
        is_grasped = self._grip.grasps()[..., 0]
        if is_grasped.any():
            self._was_lifted = self._was_lifted | (is_grasped & self._grip.is_free())
            is_near = self._was_lifted & (distance <= HAND_OVER)
            self._was_delivered = np.where(is_grasped, is_near, self._was_delivered)
        beside = np.sqrt(offset[..., 0] * offset[..., 0] + offset[..., 1] * offset[..., 1])
        is_there = self._was_delivered & is_ready & (forces[..., self._on] > 0.0) & (beside <= tolerance)
        is_there = is_there & is_flat(pose)
        is_released = forces[..., self._elsewhere] == 0.0
        success = self._rest.count(is_there & is_released, pose[..., None, :3])
        reach = nearness(norm(pose[..., :3] - poses[..., self._tcp, :3]))
        near = nearness(distance, steepness=2.5)  # it is carried by up to half a metre
        on_the_way = reach + is_grasped * uprightness(pose) * (2.0 + self._was_lifted * (1.0 + 3.0 * near))
        progress = np.where(is_there, 8.0 + is_released, on_the_way) * (1.0 / 9.0)
        is_touched = forces[..., self._touched] > TOUCH_FORCE
        info = {"is_grasped": is_grasped, "is_touched": is_touched, **self.seen()}
        return Judgement(success=success, progress=progress, is_placed=is_there & is_released, info=info)


def is_flat(pose: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether the z axes of poses (*leading, 7) are vertical; a cuboid upside down is the same."""
    return uprightness(pose) > np.cos(MAX_TILT)


def uprightness(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cosine of the angle between the z axes of poses (*leading, 7) and the vertical, up or down."""
    x, y = pose[..., 3], pose[..., 4]
    return np.abs(1.0 - 2.0 * (x * x + y * y))
