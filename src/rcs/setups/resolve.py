"""From a setup to its parts: everything that it names is looked up, and fits together."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np

from rcs.devices import Arm, Camera, CameraMode, Gripper, Hand, lookup
from rcs.envs.cameras import ALL
from rcs.envs.gates.gate import Gate
from rcs.envs.layers import Layer
from rcs.envs.parts import Parts
from rcs.envs.setup import Setup
from rcs.envs.task import Task
from rcs.errors import InvalidSetup, UnknownName
from rcs.hardware.devices import Devices
from rcs.hardware.site import DeviceAddress, Site
from rcs.kinematics.chain import damped, load
from rcs.robots.camera import CameraDescription, ResolutionMode, parse_mode
from rcs.robots.cameras import PINHOLE, RATES
from rcs.robots.compliance import Compliance
from rcs.robots.description import ArmDescription, Description, GripperDescription, HandDescription, Mount
from rcs.robots.tactile import TactileDescription
from rcs.setups.calibration import calibrated
from rcs.setups.lab import Lab, Stand, lab_of
from rcs.sim.scene import CameraPlacement, RobotPlacement
from rcs.sim.tactile_mounts import TactilePlacement, on_pads
from rcs.spatial import Pose, wxyz_to_xyzw
from rcs.tasks.clutter import Distractors

CAMERA_IN_OPTICAL = Pose((0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
"""MuJoCo's cameras look along -z with y up, the optical frame has z forward and y down: half a turn about x."""

NO_END_EFFECTOR = "none"
"""Stands for a bare flange."""

AnyLayer = Layer | type[Layer] | str
"""A layer, its class, the name of its entry point, or `module:Class`."""

Hardware = str | Path | DeviceAddress | Arm | Gripper | Hand | Camera
"""A device, or its address."""


def lab_of_setup(setup: Setup) -> Lab:
    """Return the lab of a setup, with its own cameras and their calibration.

    Raises:
        UnknownName: There is no such robot.
        InvalidSetup: The calibration file is invalid.
    """
    lab = lab_of(setup.robot)
    lab = replace(lab, cameras={**lab.cameras, **setup.cameras.mounts})
    return lab if setup.cameras.calibration is None else calibrated(lab, setup.cameras.calibration)


def with_camera_names(setup: Setup) -> Setup:
    """Return a setup that names its cameras, where it has all of them.

    Raises:
        UnknownName: There is no such robot.
    """
    if setup.cameras.names != (ALL,):
        return setup
    return replace(setup, cameras=replace(setup.cameras, names=tuple(lab_of_setup(setup).cameras)))


def resolve(setup: Setup) -> Parts:
    """Look up everything that a setup names.

    Raises:
        UnknownName: A name that does not exist; the message has the nearest match.
        InvalidSetup: Parts that do not fit each other.
    """
    setup = with_camera_names(setup)
    lab = lab_of_setup(setup)
    task: Any = lookup.find("task", setup.task)
    if not (isinstance(task, type) and issubclass(task, Task)):
        raise InvalidSetup(f"{setup.task!r} is {task!r}; valid is a subclass of rcs.envs.task.Task.")
    names = [stand.name for stand in lab.stands]
    if isinstance(setup.end_effector, Mapping) and (unknown := sorted(setup.end_effector.keys() - set(names))):
        raise UnknownName("robot of this setup", unknown[0], names)
    robots = tuple(
        _place(one, setup.end_effector_of(one.name) or lab.end_effector, setup.compliance) for one in lab.stands
    )
    cameras = tuple(_mount(name, setup, lab, robots) for name in setup.cameras.names)
    if setup.cameras.mode is not None:
        for camera in cameras:
            if camera.camera.modes != PINHOLE.modes or parse_mode(setup.cameras.mode) is None:
                camera.camera.mode(setup.cameras.mode)
    tactile = tuple(sensor for robot in robots for sensor in _feel(setup.tactile, robot))
    count = 0 if setup.randomisation is None else setup.randomisation.distractors
    return Parts(
        setup=setup,
        robots=robots,
        cameras=cameras,
        obstacles=lab.obstacles,
        tactile=tactile,
        task=task(lab.area, setup.task_options),
        clutter=Distractors(count, scale=lab.area.object_scale) if count else None,
        layers=layers_by_robot(dict.fromkeys(names, setup.layers), names),
        gates=[_gate(name, options) for name, options in setup.gates.items()],
    )


def _feel(name: str | None, robot: RobotPlacement) -> tuple[TactilePlacement, ...]:
    if name is None:
        return ()
    sensor: TactileDescription = lookup.find("tactile", name)
    if robot.gripper is None:
        carried = robot.end_effector.label if robot.end_effector is not None else "A bare flange"
        raise InvalidSetup(
            f"{carried} has no pads for {sensor.label} to take the place of; {', '.join(lookup.names('gripper'))} have."
        )
    return on_pads(robot, sensor)


def _place(stand: Stand, end_effector: str | None, compliance: Compliance | None) -> RobotPlacement:
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
    return RobotPlacement(
        name=stand.name,
        arm=arm,
        gripper=gripper,
        hand=hand,
        base_in_scene=stand.base_in_scene,
        compliance=None if compliance is None else damped(compliance, arm, gripper or hand),
    )


def _mount(name: str, setup: Setup, lab: Lab, robots: tuple[RobotPlacement, ...]) -> CameraPlacement:
    if name not in lab.cameras:
        own = cameras_of(robots)
        if name in own:
            return own[name]
        raise UnknownName(f"camera in the lab of {setup.robot_label!r}", name, {*lab.cameras, *own})
    mount = lab.cameras[name]
    parent = "world"
    if mount.on_gripper_of is not None:
        by_name = {robot.name: robot for robot in robots}
        if (robot := by_name.get(mount.on_gripper_of)) is None:
            hint = f"Camera {name!r} is mounted on its gripper."
            raise UnknownName("robot of this setup", mount.on_gripper_of, by_name, hint=hint)
        if robot.end_effector is None:
            raise InvalidSetup(f"Camera {name!r} is mounted on the gripper of {robot.name!r}, which has none.")
        if name not in setup.cameras.mounts and robot.end_effector.name != lab.end_effector:
            raise InvalidSetup(
                f"Camera {name!r} is made to be mounted on {lab.end_effector!r}, not on {robot.end_effector.name!r}; "
                "leave it out."
            )
        parent = robot.gripper_prefix + robot.end_effector.base_body
    return CameraPlacement(
        name=name,
        camera=lookup.find("camera", mount.camera),
        parent_body=parent,
        optical_in_parent=mount.optical,
        calibration=mount.calibration,
    )


def layers_by_robot(given: Mapping[str, Sequence[AnyLayer]], robots: Sequence[str]) -> dict[str, list[Layer]]:
    """Return the user's layers by robot, made where they are classes or names.

    Raises:
        UnknownName: There is no such robot or layer.
        InvalidSetup: A layer is no layer, or is given to several robots.
    """
    if unknown := sorted(set(given) - set(robots)):
        raise UnknownName("robot of this setup", unknown[0], robots)
    made = {name: [one_of("layer", layer, Layer) for layer in own] for name, own in given.items()}
    every = [id(layer) for own in made.values() for layer in own]
    if len(set(every)) != len(every):
        raise InvalidSetup("A layer remembers the targets of one robot; give each robot its own, or the layer's class.")
    return made


def one_of(kind: Literal["layer", "gate"], given: Any, wanted: type[Any]) -> Any:
    """Return a layer or gate from an object, a class or a name.

    Raises:
        InvalidSetup: It is something else.
        UnknownName: There is no such name.
    """
    found = lookup.find(kind, given)
    found = found() if isinstance(found, type) else found
    if not isinstance(found, wanted):
        raise InvalidSetup(f"{given!r} is no {kind}; valid is an object or class of {wanted.__name__}, or its name.")
    return found


def _gate(name: str, options: Mapping[str, Any]) -> Gate:
    """Return a gate that a setup names."""
    found = lookup.find("gate", name)
    if not (isinstance(found, type) and issubclass(found, Gate)):
        raise InvalidSetup(f"{name!r} is {found!r}; valid is a subclass of rcs.envs.Gate.")
    try:
        return found(**options)
    except TypeError as err:
        valid = ", ".join(one for one in inspect.signature(found.__init__).parameters if one != "self")
        raise InvalidSetup(
            f"The gate {name!r} cannot be made with {dict(options)}: {err}; valid options: {valid}."
        ) from err


def site_of(setup: Setup, hardware: Any) -> Site:
    """Return the site that `hardware` of `make` stands for in a setup; nothing is connected.

    Raises:
        InvalidSetup: It is none of what is valid there.
        UnknownName: A name in it, or in the setup, does not exist.
    """
    parts = resolve(setup)
    robots = {robot.name: (robot.arm, robot.end_effector) for robot in parts.robots}
    return Site.of(hardware, robots, [one.name for one in parts.cameras], [one.name for one in parts.tactile])


def devices_of(hardware: Any, parts: Parts) -> Devices:
    """Return the devices that `hardware` of `make` stands for; nothing is connected.

    Raises:
        InvalidSetup: It is none of what is valid there.
        UnknownName: A name in it does not exist.
    """
    if hardware is None:
        return Devices()
    robots = {robot.name: (robot.arm, robot.end_effector) for robot in parts.robots}
    cameras = {camera.name: (camera.camera, _mode(parts.setup, camera)) for camera in parts.cameras}
    tactile = {sensor.name: sensor.sensor for sensor in parts.tactile}
    compliance = {robot.name: robot.compliance for robot in parts.robots if robot.compliance is not None}
    return Site.of(hardware, robots, list(cameras), list(tactile)).devices(robots, cameras, tactile, compliance)


def _mode(setup: Setup, camera: CameraPlacement) -> CameraMode:
    """Return the mode of a real camera that frames of a setup are cut out of.

    That is the smallest mode that is large enough; where none is, the largest.
    """
    width, height = setup.cameras.size_of(camera.name)
    rate = camera.camera.frame_rate((width, height), setup.cameras.fps_of(camera.name))
    modes = sorted(
        (mode for mode in camera.camera.modes if rate in mode.rates), key=lambda mode: mode.width * mode.height
    )
    mode = next((mode for mode in modes if mode.width >= width and mode.height >= height), modes[-1])
    return CameraMode(mode.width, mode.height, rate, setup.cameras.depth)


def cameras_of(robots: Sequence[RobotPlacement]) -> dict[str, CameraPlacement]:
    """Return the cameras that the files of arms and end effectors define, by name.

    A camera is fixed to its body at the pose that the file says, with the file's `fovy`, or the one that follows from
    `focal` and `sensorsize`. With several robots, `<robot>_` stands before its name. Cameras without a name are left
    out.

    Args:
        robots: The robots of a scene.

    Raises:
        InvalidSetup: Two cameras have the same name, or one of them turns by itself or is not an ideal one.
    """
    found: dict[str, CameraPlacement] = {}
    for robot in robots:
        parts = [(robot.prefix, robot.arm), (robot.gripper_prefix, robot.end_effector)]
        for prefix, part in parts:
            for camera in () if part is None else _cameras_in(part, prefix):
                name = camera.name
                known = name if len(robots) == 1 else f"{robot.name}_{name}"
                if known in found:
                    raise InvalidSetup(f"Robot {robot.name!r} has two cameras named {name!r}; rename one in its file.")
                found[known] = replace(camera, name=known)
    return found


def _cameras_in(part: Description, prefix: str) -> Iterator[CameraPlacement]:
    """Yield the cameras in the file of a part, whose bodies have a prefix before their names."""
    spec = load(part)
    if not spec.cameras:
        return
    model = spec.compile()
    for i in range(model.ncam):
        if not (name := model.camera(i).name.replace("/", "_")):
            continue
        if model.cam_mode[i] != mujoco.mjtCamLight.mjCAMLIGHT_FIXED:
            raise InvalidSetup(f"Camera {name!r} in {part.mjcf_file} turns by itself; valid is mode='fixed'.")
        if model.cam_intrinsic[i, 2:].any() or model.cam_projection[i] != mujoco.mjtProjection.mjPROJ_PERSPECTIVE:
            raise InvalidSetup(
                f"Camera {name!r} in {part.mjcf_file} is orthographic or its principal point is not in the middle of "
                "the image; drawn are perspective images about their middle."
            )
        # A camera in the file's world moves with the base, which has no pose there.
        body = model.body(int(model.cam_bodyid[i])).name if model.cam_bodyid[i] else part.base_body
        optical = Pose(model.cam_pos[i], wxyz_to_xyzw(model.cam_quat[i])) * CAMERA_IN_OPTICAL
        camera = _description(name, model, i)
        yield CameraPlacement(name=name, camera=camera, parent_body=prefix + body, optical_in_parent=Mount.of(optical))


def _description(name: str, model: mujoco.MjModel, i: int) -> CameraDescription:
    width, height = (int(edge) for edge in model.cam_resolution[i])
    camera = replace(PINHOLE, name=name, label=f"Camera {name}", fovy=float(np.deg2rad(model.cam_fovy[i])))
    if width == 1:  # the file gives no resolution
        return camera
    return replace(camera, native_aspect=width / height, modes=(ResolutionMode(width, height, RATES),))
