"""Ports of what learners and force control need beside positions: torques, wrench, contacts, and poses of objects."""

from __future__ import annotations

from collections.abc import Collection

import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from rcs._core import FingerContacts, FreeBodyVelocity
from rcs.envs import spaces as keys
from rcs.envs.ports.port import Port
from rcs.envs.spaces import Observation
from rcs.envs.start import base_in_scene, in_frame_of
from rcs.envs.task import Task
from rcs.errors import InvalidSetup
from rcs.sim.loads import SimLoads
from rcs.sim.robot import SimRobot
from rcs.sim.world import World
from rcs.spatial import Pose

TOUCH_FORCE = 0.5
"""Least normal force of a finger that counts as contact [N] (ManiSkill's PickCube)."""


class SimLoadPort(Port):
    """Torques at the joints and the wrench on the tool of a simulated robot."""

    def __init__(self, robot: SimRobot, observed: Collection[keys.Observed]) -> None:
        """Measure the loads of a robot.

        Args:
            robot: The robot.
            observed: `torques`, `wrench` or both.
        """
        self._loads = SimLoads(robot)
        own = keys.load_spaces(robot.placement.arm.effort_limit)
        self.observation_spaces = {keys.LOADS[name]: own[keys.LOADS[name]] for name in keys.LOADS if name in observed}

    def observe(self) -> Observation:
        """Read what is observed."""
        loads = {keys.JOINT_TORQUES: self._loads.joint_torques, keys.TCP_WRENCH: self._loads.tcp_wrench}
        return {key: loads[key] for key in self.observation_spaces}


class SimContactPort(Port):
    """Which fingers of a simulated gripper or hand touch something, and whether they hold an object."""

    def __init__(self, robot: SimRobot) -> None:
        """Measure the contacts of a gripper's pads, or of a hand's fingers.

        Raises:
            InvalidSetup: The robot has neither.
        """
        world, placement = robot.world, robot.placement
        if placement.gripper is not None:
            fingers = list(placement.gripper.pad_geoms)
        elif placement.hand is not None:
            fingers = list(placement.hand.finger_geoms.values())
        else:
            raise InvalidSetup(f"Robot {placement.name!r} has no fingers whose contacts could be observed.")
        flags = [world.geom_flags(placement.gripper_prefix + name for name in names) for names in fingers]
        own = world.subtree_flags(placement.base_body)[: world.model.ngeom]
        self._world = world
        self._first = world.core.measure(FingerContacts(world.model, flags, own, TOUCH_FORCE))
        world.refresh()
        self._last = self._first + len(fingers)
        self.observation_spaces = {
            keys.FINGER_CONTACTS: keys.flags_space(len(fingers)),
            keys.IS_GRASPED: keys.flags_space(1),
        }

    def observe(self) -> Observation:
        """Read which fingers touch something other than the robot, and whether two touch the same movable object."""
        flags = self._world.measurements[..., self._first : self._last + 1].astype(np.uint8)
        return {keys.FINGER_CONTACTS: flags[..., :-1], keys.IS_GRASPED: flags[..., -1:]}


class PrivilegedPort(Port):
    """Poses and velocities of the task's objects, which no real robot knows, as `privileged`/object."""

    def __init__(self, world: World, robots: list[SimRobot], task: Task) -> None:
        """Look up the objects of a task that is bound to its world, and have rigid ones read out.

        Raises:
            InvalidSetup: The task has no poses of objects, or one has the name of no body.
        """
        poses, task_name = task.object_poses(), type(task).__name__
        if not poses and task.objects():
            raise InvalidSetup(
                f"observe=('privileged',) shows the objects of {task_name}.object_poses, which it does not define; it "
                f"has {', '.join(map(repr, task.objects()))} in objects. Have object_poses return the pose of each in "
                "the scene by its name, (*leading, 7), or leave 'privileged' out of observe."
            )
        if not poses:
            raise InvalidSetup(f"{task_name} has no objects to observe; leave 'privileged' out of observe.")
        bodies = {world.model.body(body).name for body in range(world.model.nbody)}
        if unknown := sorted(poses.keys() - bodies):
            raise InvalidSetup(
                f"{task_name}.object_poses names {unknown[0]!r}, and the scene has no body of that name; it has "
                f"{', '.join(sorted(task.objects()))}."
            )
        self._objects = {name: _motion_of(world, robots, task, name) for name in poses}
        world.refresh()
        own = keys.object_space()
        self.observation_spaces = {keys.PRIVILEGED: spaces.Dict(dict.fromkeys(self._objects, own))}

    def observe(self) -> Observation:
        """Read all objects."""
        return {
            keys.PRIVILEGED: {
                name: {keys.TQUAT: motion.pose(), keys.VELOCITY: motion.velocity()}
                for name, motion in self._objects.items()
            }
        }


class _RigidMotion:
    """Motion of a body that is free, or that only the task places, such as a mark; the threads that step read it.

    Motions are in the base frame of the robot; with several robots, in the scene.
    """

    def __init__(self, world: World, body: int, frame_body: int, joint: int | None) -> None:
        self._world = world
        self._pose = world.core.read_body_pose(body, frame_body)
        self._first = None if joint is None else world.core.measure(FreeBodyVelocity(world.model, joint, frame_body))

    def pose(self) -> NDArray[np.float64]:
        """Return translation [m] and quaternion xyzw, (*leading, 7), as they were read."""
        return self._world.poses[..., self._pose, :].copy()

    def velocity(self) -> NDArray[np.float64]:
        """Return velocity [m/s] and angular velocity [rad/s] of the origin, (*leading, 6); zeros without a joint."""
        if self._first is None:
            return np.zeros((*self._world.leading, 6))
        return self._world.measurements[..., self._first : self._first + 6].copy()


class _SoftMotion:
    """Motion of a soft body whose nodes slide along the scene's axes: mean velocity and mean spin of its nodes."""

    def __init__(self, world: World, robots: list[SimRobot], task: Task, name: str, bodies: NDArray[np.intp]) -> None:
        model = world.model
        first = model.body_jntadr[bodies]
        self._world = world
        self._robots = robots
        self._task = task
        self._name = name
        self._bodies = bodies
        self._qpos = (model.jnt_qposadr[first][:, None] + np.arange(3)).ravel()
        self._dof = (model.jnt_dofadr[first][:, None] + np.arange(3)).ravel()
        base = base_in_scene([robot.placement for robot in robots])
        self._scene_in_base = Pose(base[:3], base[3:]).inverse().matrix[:3, :3]

    def pose(self) -> NDArray[np.float64]:
        """Return the pose of the task."""
        return in_frame_of(self._robots, {self._name: self._task.object_poses()[self._name]})[self._name]

    def velocity(self) -> NDArray[np.float64]:
        """Return velocity and spin about the middle."""
        shape = (*self._world.leading, len(self._bodies), 3)
        places = self._world.field("body_pos")[..., self._bodies, :] + self._world.qpos[..., self._qpos].reshape(shape)
        velocities = self._world.qvel[..., self._dof].reshape(shape)
        places, mean = places - _mean(places)[..., None, :], _mean(velocities)
        spin = _mean(np.cross(places, velocities - mean[..., None, :]))
        products = places[..., :, None] * places[..., None, :]
        trace = places[..., 0] ** 2 + places[..., 1] ** 2 + places[..., 2] ** 2
        inertia = _mean(trace[..., None, None] * np.eye(3) - products, axes=2)
        angular = np.linalg.solve(inertia, spin[..., None])[..., 0].astype(np.float64, copy=False)
        return np.concatenate([_turned(self._scene_in_base, part) for part in (mean, angular)], -1)


def _motion_of(world: World, robots: list[SimRobot], task: Task, name: str) -> _RigidMotion | _SoftMotion:
    model = world.model
    body = model.body(name).id
    joint = int(model.body_jntadr[body])
    frame_body = robots[0].layout.base_body if len(robots) == 1 else 0
    if joint >= 0 and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
        return _RigidMotion(world, body, frame_body, joint)
    if model.body_mocapid[body] >= 0:
        return _RigidMotion(world, body, frame_body, None)
    nodes = np.flatnonzero((model.body_parentid == body) & (model.body_jntnum == 3))
    if not len(nodes):
        raise InvalidSetup(
            f"The object {name!r} has no free joint, and is neither soft nor a mocap body; its velocity is not known."
        )
    return _SoftMotion(world, robots, task, name, nodes)


# In a fixed order, unlike NumPy's sums and matrix products: copies must have the bits of a single environment.
def _mean(values: NDArray[np.float64], axes: int = 1) -> NDArray[np.float64]:
    """Return the mean over the nodes, the axis before the last `axes`."""
    count = values.shape[-1 - axes]
    nodes = np.moveaxis(values, -1 - axes, 0)
    total = nodes[0].copy()
    for node in nodes[1:]:
        total += node
    return total * (1.0 / count)


def _turned(rotation: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z = (vectors[..., i] for i in range(3))
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in rotation], -1)
