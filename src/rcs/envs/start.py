"""A given start of an episode: joints of the robots and poses of the objects."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from rcs.envs import spaces as keys
from rcs.errors import InvalidSetup
from rcs.sim.robot import SimRobot
from rcs.sim.scene import RobotPlacement
from rcs.spatial import compose, inverse, normalize

MARGIN = 0.1
"""Tolerance of bounds for measurement errors [rad, or of 1]; a start within it is clipped."""


@dataclass(frozen=True, kw_only=True)
class Start:
    """A checked start; missing parts are left to the robots' home and to the task."""

    robots: dict[str, dict[str, NDArray[Any]]] = field(default_factory=dict[str, dict[str, NDArray[Any]]])
    """For robots by name: `joints` [rad], and `gripper` or `hand`, as in an observation."""
    objects: dict[str, NDArray[np.float64]] = field(default_factory=dict[str, NDArray[np.float64]])
    """Poses of objects in the scene by name, (7,) [m], xyzw."""


def check_start(robots: Sequence[RobotPlacement], known: Mapping[str, Any], robot: Any, objects: Any) -> Start:
    """Check a start.

    Args:
        robots: Robots of the environment.
        known: The objects of its task, by name; none where nothing is simulated.
        robot: `joints`, and `gripper` or `hand`, as in an observation; with several robots, nested under their names.
            None for home.
        objects: Poses by name, (7,) [m], xyzw, in the base frame; with several robots, in the scene. None to leave them
            to the task.

    Raises:
        InvalidSetup: A name or key is unknown, or a value has a wrong shape, is not finite or is out of bounds.
    """
    if not robots:
        raise InvalidSetup("This environment knows no robots that could be put at a start; give Env(robots=...).")
    given: Any = {} if robot is None else robot if len(robots) > 1 else {robots[0].name: robot}
    names = [one.name for one in robots]
    if not isinstance(given, Mapping) or not given.keys() <= set(names):
        raise InvalidSetup(f"The option 'robot' is {_form(robot)}; valid is a mapping for robots among {names}.")
    states = {one.name: _check_robot(one, given[one.name]) for one in robots if one.name in given}
    if objects is not None and (not isinstance(objects, Mapping) or not objects.keys() <= known.keys()):
        raise InvalidSetup(f"The option 'objects' is {_form(objects)}; valid are poses of {sorted(known)}.")
    base = base_in_scene(robots)
    poses = {name: compose(base, _check_pose(name, pose)) for name, pose in (objects or {}).items()}
    return Start(robots=states, objects=poses)


def check_state(state: Any, size: int) -> NDArray[np.float64]:
    """Return a checked simulation state to start from, (size,).

    Raises:
        InvalidSetup: It has a wrong shape, or a value that MuJoCo treats as divergence.
    """
    array = _as_array("The option 'state'", state)
    if array.shape != (size,):
        raise InvalidSetup(f"The option 'state' has shape {array.shape}; valid is ({size},).")
    if not (np.abs(array) <= mujoco.mjMAXVAL).all():  # also catches NaN
        raise InvalidSetup(f"The option 'state' has values that are not finite or beyond ±{mujoco.mjMAXVAL:g}.")
    return array


def base_in_scene(robots: Sequence[RobotPlacement]) -> NDArray[np.float64]:
    """Return the frame of objects' poses, (7,): the robot's base, or with several robots the scene."""
    pose = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    if len(robots) == 1:
        base = robots[0].base_in_scene
        pose[:3], pose[3:] = base.translation, base.quaternion
    return pose


def in_frame_of(robots: list[SimRobot], poses: Mapping[str, NDArray[np.float64]]) -> dict[str, NDArray[np.float64]]:
    """Convert poses in the scene to the frame of objects' poses: the base, or with several robots the scene."""
    if len(robots) != 1:
        return dict(poses)
    scene_in_base = inverse(base_in_scene([one.placement for one in robots]))
    return {name: compose(scene_in_base, pose) for name, pose in poses.items()}


def _check_robot(placement: RobotPlacement, given: Any) -> dict[str, NDArray[Any]]:
    arm = placement.arm
    boxes = {keys.JOINTS: keys.joints_space(arm.joint_lower, arm.joint_upper)}
    if placement.gripper is not None:
        boxes[keys.GRIPPER] = keys.normalised_space(1)
    if placement.hand is not None:
        boxes[keys.HAND] = keys.normalised_space(len(placement.hand.joints))
    if not isinstance(given, Mapping) or keys.JOINTS not in given or not given.keys() <= boxes.keys():
        raise InvalidSetup(
            f"The option 'robot' of {placement.name!r} is {_form(given)}; valid are 'joints' and of {sorted(boxes)}."
        )
    checked: dict[str, NDArray[Any]] = {}
    for key, value in given.items():
        box = boxes[key]
        array = _as_array(f"The start's {key!r}", value)
        if array.shape != box.shape or not np.isfinite(array).all():
            raise InvalidSetup(f"The start's {key!r} has shape {array.shape}; valid are {box.shape} finite numbers.")
        # Joints are sometimes measured slightly outside of their limits; they start inside.
        checked[key] = np.clip(array, box.low, box.high).astype(box.dtype)
        if (np.abs(checked[key] - array) > MARGIN).any():
            raise InvalidSetup(f"The start's {key!r} is {array}; valid is {box.low} to {box.high}.")
    return checked


def _check_pose(name: str, pose: Any) -> NDArray[np.float64]:
    array = _as_array(f"The pose of {name!r}", pose)
    if array.shape != (7,) or not np.isfinite(array).all() or np.linalg.norm(array[3:]) < keys.MINIMAL_NORM:
        raise InvalidSetup(
            f"The pose of {name!r} is {pose!r}; valid are 7 numbers: translation [m] and quaternion xyzw."
        )
    return normalize(array)


def _as_array(what: str, value: Any) -> NDArray[np.float64]:
    if np.ma.is_masked(value):
        raise InvalidSetup(f"{what} has masked values; valid is an array without a mask.")
    try:
        return np.asarray(value, np.float64)
    except (TypeError, ValueError) as err:
        raise InvalidSetup(f"{what} is {_form(value)}; valid are numbers.") from err


def _form(given: Any) -> str:
    return f"a mapping with {sorted(map(str, given))}" if isinstance(given, Mapping) else repr(given)
