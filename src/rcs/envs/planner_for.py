"""A planner for a robot of a simulated environment, which knows what is around it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rcs._core import CollisionChecker
from rcs.envs.env import Env
from rcs.errors import InvalidSetup, UnknownName
from rcs.kinematics import kinematics_of
from rcs.planning.path import JointLimits
from rcs.planning.planner import Planner
from rcs.sim.robot import RobotLayout
from rcs.sim.scene import RobotPlacement
from rcs.sim.world import World
from rcs.spatial import Pose, wxyz_to_xyzw


class ScenePlanner(Planner):
    """Plans for one robot of a simulated world. Other robots are obstacles, where they are."""

    def __init__(
        self, world: World, placement: RobotPlacement, *, speed: float = 1.0, copy: int = 0, **options: Any
    ) -> None:
        """Look the robot up; obstacles are where the world has them now.

        Args:
            world: The world.
            placement: The robot.
            speed: Share of the speed that the robot can do, for times.
            copy: The copy, in a world of copies.
            options: Options of `Planner`.
        """
        self._world, self._copy = world, copy
        self._layout = RobotLayout.of(placement, world.model)
        super().__init__(
            CollisionChecker(world.model, [self._layout.joint_ids]),
            JointLimits.of(placement.arm, scale=speed),
            kinematics_of(placement.arm, placement.end_effector),
            **options,
        )
        self.look()

    def look(self) -> None:
        """Take where everything is now."""
        state, data = self._qpos(), self._world.data
        if data is None:
            self.checker.set_state(state)
        else:
            self.checker.set_state(state, data.mocap_pos.ravel(), data.mocap_quat.ravel())

    @property
    def joints(self) -> NDArray[np.float64]:
        """The robot's joints now [rad], (dof,)."""
        return self._qpos()[self._layout.qpos].copy()

    def put(self, joints: ArrayLike) -> None:
        """Put the robot of the world at joints [rad], (dof,), to look at it; time does not pass."""
        self._qpos()[self._layout.qpos] = joints
        self._world.refresh()

    def attach(self, body: str, in_tcp: Pose | None = None) -> None:
        """Let a free body, such as a grasped object, move with the gripper.

        Args:
            body: Its name.
            in_tcp: Its pose in the TCP's frame; None for where both are now.

        Raises:
            InvalidSetup: The body is not free.
            UnknownName: There is none of this name.
        """
        self.look()
        model, site = self._world.model, self._layout.tcp_site
        place = None
        if in_tcp is not None:
            quaternion = wxyz_to_xyzw(model.site_quat[site])
            place = Pose(model.site_pos[site], quaternion) * in_tcp
        self.checker.attach(self._body(body), int(model.site_bodyid[site]), place)

    def detach(self, body: str) -> None:
        """Let an attached body be where it is.

        Raises:
            InvalidSetup: It is not attached.
            UnknownName: There is none of this name.
        """
        self.checker.detach(self._body(body))
        self.look()

    def _qpos(self) -> NDArray[np.float64]:
        qpos = self._world.qpos
        return qpos if qpos.ndim == 1 else qpos[self._copy]

    def _body(self, name: str) -> int:
        model = self._world.model
        names = [model.body(i).name for i in range(model.nbody)]
        if name not in names:
            raise UnknownName("body", name, [name for name in names if name])
        return names.index(name)


def planner_for(env: Env, robot: str | None = None, **options: Any) -> ScenePlanner:
    """Return a planner for a robot of a simulated environment.

    Args:
        env: The environment.
        robot: Name of the robot; None for the only one.
        options: Options of `Planner`, such as `planner` and `margin`, and `speed`, the used share of the robot's.

    Raises:
        WrongOrder: The environment is not simulated.
        InvalidSetup: There are several robots and none was named, or an option is not valid.
        UnknownName: There is no robot of this name.
    """
    if robot is None and len(env.robots) > 1:
        raise InvalidSetup(f"There are several robots; name one: {', '.join(env.robots)}.")
    name = robot or next(iter(env.robots))
    if name not in env.robots:
        raise UnknownName("robot", name, env.robots)
    return ScenePlanner(env.simulation.world, env.robots[name], **options)
