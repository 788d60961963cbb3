"""A planner for a robot of a simulated environment, which knows what is around it."""

from __future__ import annotations

from copy import copy as copied
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs._core import CollisionChecker
from rcs.envs.env import Env
from rcs.envs.gates.guarded_scene import GEOMETRY
from rcs.errors import InvalidSetup, UnknownName, WrongOrder
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
        self._shapes = self._present_shapes()
        super().__init__(
            self._make_checker(),
            JointLimits.of(placement.arm, scale=speed),
            kinematics_of(placement.arm, placement.end_effector),
            **options,
        )
        self.look()

    def look(self) -> None:
        """Take where everything is now.

        Raises:
            WrongOrder: Shapes have changed, as randomised ones do from one episode to the next.
        """
        shapes = self._present_shapes()
        if any(not np.array_equal(shapes[name], self._shapes[name]) for name in GEOMETRY):
            raise WrongOrder("The sizes of objects have changed since this planner was made; make a new one.")
        self.checker.set_state(self._qpos(), *self._mocap())

    @property
    def joints(self) -> NDArray[np.float64]:
        """The robot's joints now [rad], (dof,)."""
        return self._qpos()[self._layout.qpos].copy()

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

    def _present_shapes(self) -> dict[str, NDArray[Any]]:
        """Return the fields of this copy's model that say where shapes are and how large."""
        return {name: np.array(self._of_copy(self._world.field(name))) for name in GEOMETRY}

    def _make_checker(self) -> CollisionChecker:
        """Return a checker with the shapes that were seen last."""
        model = self._world.model
        if self._world.leading:
            model = copied(model)
            for name, values in self._shapes.items():
                getattr(model, name)[:] = values
        return CollisionChecker(model, [self._layout.joint_ids])

    def _of_copy(self, values: NDArray[Any]) -> NDArray[Any]:
        return values[self._copy] if self._world.leading else values

    def _qpos(self) -> NDArray[np.float64]:
        return self._of_copy(self._world.qpos)

    def _mocap(self) -> list[NDArray[np.float64]]:
        """Return the positions and quaternions of the bodies with `mocap`, if there are any."""
        kinds = (mujoco.mjtState.mjSTATE_MOCAP_POS, mujoco.mjtState.mjSTATE_MOCAP_QUAT)
        component = self._world.core.component
        return [self._of_copy(component(kind.value)) for kind in kinds] if self._world.model.nmocap else []

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
