"""`make` and `make_vec`: from names to environments."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from rcs.devices import lookup
from rcs.envs.assemble import Parts, assemble, assemble_vec
from rcs.envs.env import Env
from rcs.envs.setup import Setup
from rcs.envs.task import Task
from rcs.envs.vector import VecEnv
from rcs.errors import InvalidSetup, UnknownName
from rcs.robots.description import ArmDescription, CameraDescription, GripperDescription, HandDescription
from rcs.robots.tactile import TactileDescription
from rcs.setups.calibration import calibrated
from rcs.setups.lab import Lab, Stand, lab_of
from rcs.sim.scene import CameraPlacement, RobotPlacement
from rcs.sim.tactile_mounts import on_pads
from rcs.sim.tactile_placement import TactilePlacement

NO_END_EFFECTOR = "none"
"""Asks for a bare flange."""


def make(task: str | Setup = "PickCuboid", *, render_mode: str | None = None, **options: Any) -> Env:
    """Make an environment.

    Args:
        task: Name of the task, or a whole setup.
        render_mode: `rgb_array` for an environment whose `render` draws; None for none.
        options: Fields of `Setup`.

    Raises:
        UnknownName: A task, robot, end effector or camera that does not exist.
        InvalidSetup: An option that does not make sense.

    Example:
        >>> import rcs
        >>> env = rcs.make("PickCuboid", robot="fr3", control="joints", relative=True, frequency=30)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    """
    if render_mode not in (None, "rgb_array"):
        raise InvalidSetup(f"render_mode is {render_mode!r}; valid: None, 'rgb_array'.")
    return assemble(resolve(_setup(task, options)), has_picture=render_mode is not None)


def make_vec(
    task: str | Setup = "PickCuboid",
    *,
    copies: int = 2,
    threads: int = 0,
    autoreset: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    **options: Any,
) -> VecEnv:
    """Make many copies of an environment that are stepped together on native threads.

    Args:
        task: Name of the task, or a whole setup.
        copies: Number of copies.
        threads: Threads for physics and rendering, 0 for one per CPU.
        autoreset: When a copy starts its next episode: `NextStep`, `SameStep` or `Disabled` (gymnasium's).
        options: Fields of `Setup`.

    Raises:
        UnknownName: A task, robot, end effector or camera that does not exist.
        InvalidSetup: An option that does not make sense.

    Example:
        >>> import rcs
        >>> envs = rcs.make_vec("PickCuboid", copies=24, robot="fr3")
        >>> observations, infos = envs.reset(seed=0)
    """
    for name, value, least in (("copies", copies, 1), ("threads", threads, 0)):
        if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
            raise InvalidSetup(f"{name} is {value!r}; valid is a whole number from {least}.")
    copies, threads = int(copies), int(threads)
    setup = _setup(task, options)
    if setup.mode == "realtime":
        raise InvalidSetup("Copies have no common wall clock; use mode='async' or 'sync'.")
    try:
        mode = AutoresetMode(autoreset)
    except ValueError as err:
        valid = ", ".join(repr(one.value) for one in AutoresetMode)
        raise InvalidSetup(f"autoreset is {autoreset!r}; valid: {valid}.") from err
    return assemble_vec(resolve(setup), copies=copies, threads=threads, autoreset=mode)


def _setup(task: str | Setup, options: dict[str, Any]) -> Setup:
    if isinstance(task, Setup):
        if options:
            raise InvalidSetup(f"A setup was given and also {sorted(options)}; use dataclasses.replace on the setup.")
        return task
    return Setup.from_json({"task": task, **options})


def resolve(setup: Setup) -> Parts:
    """Look up everything that a setup names.

    Raises:
        UnknownName: A name that does not exist; the message has the nearest match.
        InvalidSetup: Parts that do not fit each other.
    """
    lab = lab_of(setup.robot)
    if setup.calibration is not None:
        lab = calibrated(lab, setup.calibration)
    task: type[Task] = lookup.find("task", setup.task)
    robots = tuple(_place(stand, setup.end_effector or lab.end_effector) for stand in lab.stands)
    cameras = tuple(_mount(name, setup, lab, robots) for name in setup.cameras)
    tactile = tuple(sensor for robot in robots for sensor in _feel(setup.tactile, robot))
    return Parts(setup=setup, robots=robots, cameras=cameras, tactile=tactile, task=task(lab.area))


def _feel(name: str | None, robot: RobotPlacement) -> tuple[TactilePlacement, ...]:
    if name is None:
        return ()
    sensor: TactileDescription = lookup.find("tactile", name)
    if robot.gripper is None:
        carried = robot.end_effector.label if robot.end_effector is not None else "A bare flange"
        raise InvalidSetup(
            f"{carried} has no pads for {sensor.label} to take the place of; "
            f"{', '.join(lookup.names('gripper'))} have. "
            "On fingertips of a hand it goes in a scene of your own: rcs.sim.tactile_mounts.on_fingertips."
        )
    return on_pads(robot, sensor)


def _place(stand: Stand, end_effector: str | None) -> RobotPlacement:
    arm: ArmDescription = lookup.find("arm", stand.arm)
    gripper: GripperDescription | None = None
    hand: HandDescription | None = None
    if end_effector is not None and end_effector != NO_END_EFFECTOR:
        if end_effector in lookup.names("hand"):
            hand = lookup.find("hand", end_effector)
        elif end_effector in lookup.names("gripper"):
            gripper = lookup.find("gripper", end_effector)
        else:
            raise UnknownName(
                "end effector", end_effector, [*lookup.names("gripper"), *lookup.names("hand"), NO_END_EFFECTOR]
            )
    mounted = gripper or hand
    if mounted is not None and arm.end_effectors is not None and mounted.name not in arm.end_effectors:
        raise InvalidSetup(
            f"{arm.label} carries {', '.join(arm.end_effectors)} and nothing else, not {mounted.name!r}."
        )
    if gripper is not None and gripper.arms is not None and arm.name not in gripper.arms:
        raise InvalidSetup(
            f"{gripper.label} is made for {', '.join(gripper.arms)}; it cannot be mounted on {arm.name!r}."
        )
    return RobotPlacement(name=stand.name, arm=arm, gripper=gripper, hand=hand, base_in_scene=stand.base_in_scene)


def _mount(name: str, setup: Setup, lab: Lab, robots: tuple[RobotPlacement, ...]) -> CameraPlacement:
    if name not in lab.cameras:
        raise UnknownName(f"camera mount in the lab of {setup.robot!r}", name, lab.cameras)
    mount = lab.cameras[name]
    parent = "world"
    if mount.on_gripper_of is not None:
        robot = next(robot for robot in robots if robot.name == mount.on_gripper_of)
        if robot.end_effector is None:
            raise InvalidSetup(f"Camera {name!r} is mounted on the gripper of {robot.name!r}, which has none.")
        if robot.end_effector.name != lab.end_effector:
            raise InvalidSetup(
                f"Camera {name!r} is made to be mounted on {lab.end_effector!r}, not on {robot.end_effector.name!r}; "
                "leave it out."
            )
        parent = robot.gripper_prefix + robot.end_effector.base_body
    description: CameraDescription = lookup.find("camera", mount.camera)
    if setup.camera_mode is not None:
        description.mode(setup.camera_mode)
    return CameraPlacement(
        name=name, camera=description, parent_body=parent, optical_in_parent=mount.optical, fovy=mount.fovy
    )
