"""The part that tasks with rigid objects on a table share: the robots that they need, and the objects' poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.devices import lookup
from rcs.devices.lookup import Kind
from rcs.envs.layers import CopyIndex
from rcs.envs.task import Task
from rcs.errors import InvalidSetup
from rcs.sim.robot import SimRobot
from rcs.sim.scene import RobotPlacement
from rcs.sim.world import World
from rcs.spatial import xyzw_to_wxyz


class FreeBody:
    """A body whose pose a task writes: a free one, whose joint and geom share its name, or one with `mocap`."""

    def __init__(self, world: World, name: str) -> None:
        """Look up its place in the state."""
        self._world = world
        self._mocap = int(world.model.body(name).mocapid[0])
        self._first = 0 if self._mocap >= 0 else int(world.model.joint(name).qposadr[0])

    def place(self, pose: NDArray[np.float64], where: CopyIndex) -> None:
        """Put the bodies of some copies at poses in the scene, (*leading of these, 7) [m], xyzw."""
        # No view is kept, which would keep the threads of a closed world.
        first, which, state = self._first, self._mocap, mujoco.mjtState
        if which < 0:
            self._world.qpos[where, first : first + 3] = pose[..., :3]
            self._world.qpos[where, first + 3 : first + 7] = xyzw_to_wxyz(pose[..., 3:])
        else:
            component = self._world.core.component
            component(state.mjSTATE_MOCAP_POS.value)[where, 3 * which : 3 * which + 3] = pose[..., :3]
            component(state.mjSTATE_MOCAP_QUAT.value)[where, 4 * which : 4 * which + 4] = xyzw_to_wxyz(pose[..., 3:])


class TableTask(Task):
    """A task with rigid objects on a table.

    A subclass names its objects and adds them in `furnish`; it puts them somewhere in `reset` by
    `self.bodies[name].place`, and finds their poses in `poses_of(name)`. Its `info` has the entries of `seen` besides
    the flags.
    """

    names: ClassVar[tuple[str, ...]]
    """Names of the objects' bodies, which robots move."""
    marks: ClassVar[tuple[str, ...]] = ()
    """Names of bodies with `mocap`, which only the task moves."""
    robots_needed: ClassVar[int] = 1
    """Number of robots."""
    takes_hands: ClassVar[bool] = False
    """Whether a hand may take the place of a gripper."""
    flags: ClassVar[tuple[str, ...]] = ("is_grasped", "is_touched")
    """Flags in `info` besides `success`, which are False at the start of an episode."""

    def seen(self) -> dict[str, NDArray[Any]]:
        """Return what `info` has of the present state besides flags, in fresh arrays."""
        return {}

    def describe(self) -> dict[str, NDArray[Any]]:
        """Return the info of the first observation of an episode."""
        never = np.zeros(self._world.leading, np.bool_)
        return {**dict.fromkeys(("success", *self.flags), never), **self.seen()}

    def objects(self) -> list[str]:
        """Return the objects."""
        return list(self.names)

    def bind(self, world: World, robots: list[SimRobot]) -> None:
        """Look up the objects.

        Raises:
            InvalidSetup: There are too many or too few robots, or one cannot grasp.
        """
        require_robots(type(self).__name__, robots, self.robots_needed, hands=self.takes_hands)
        self._world = world
        self.bodies = {name: FreeBody(world, name) for name in (*self.names, *self.marks)}
        """Objects and marks by name."""
        self._poses_in_scene = {name: world.read_pose(name) for name in self.bodies}

    def poses_of(self, name: str) -> NDArray[np.float64]:
        """Return the poses of an object or a mark in the scene, (*leading, 7) [m], xyzw; a view, not a copy."""
        return self._world.poses[..., self._poses_in_scene[name], :]

    def object_poses(self) -> dict[str, NDArray[np.float64]]:
        """Return the poses of objects and marks in the scene."""
        return {name: self.poses_of(name).copy() for name in self.bodies}

    def place(self, poses: Mapping[str, NDArray[np.float64]], where: CopyIndex) -> None:
        """Put objects and marks at given poses."""
        for name, pose in poses.items():
            if name in self.bodies:
                self.bodies[name].place(pose, where)


def require_robots(task: str, robots: Sequence[SimRobot], number: int = 1, *, hands: bool = False) -> None:
    """Check the number of robots, and that each can grasp.

    Args:
        task: Name of the task.
        robots: The robots of the setup.
        number: How many the task needs.
        hands: Whether a hand may take the place of a gripper.

    Raises:
        InvalidSetup: The task needs others; the message lists those that fit.
    """
    kinds: tuple[Kind, ...] = ("gripper", "hand") if hands else ("gripper",)
    placements = [robot.placement for robot in robots]
    lacking = [one for one in placements if (one.end_effector if hands else one.gripper) is None]
    if len(robots) == number and not lacking:
        return
    each = "a gripper or a hand" if hands else "a gripper"
    needed = f"{task} needs one robot with {each}" if number == 1 else f"{task} needs {number} robots, each with {each}"
    if len(robots) != number:
        labs = {name: lookup.find("lab", name) for name in lookup.names("lab")}
        usual = {name for kind in kinds for name in lookup.names(kind)}
        fitting = [name for name, lab in labs.items() if len(lab.stands) == number and lab.end_effector in usual]
        raise InvalidSetup(
            f"{needed}; this setup has {len(robots)}. Choose another robot (robot=, --robot): {', '.join(fitting)}."
        )
    has = lacking[0].end_effector
    fitting = sorted(name for kind in kinds for name in lookup.names(kind) if _can_carry(lacking[0], kind, name))
    raise InvalidSetup(
        f"{needed}; {lacking[0].name!r} has {'none' if has is None else has.label}. "
        f"Choose another end effector (end_effector=, --end-effector): {', '.join(fitting)}."
    )


def _can_carry(robot: RobotPlacement, kind: Kind, name: str) -> bool:
    own = robot.arm.end_effectors
    made_for = getattr(lookup.find(kind, name), "arms", None)
    return (own is None or name in own) and (made_for is None or robot.arm.name in made_for)
