"""`make` and `make_vec`: from names to environments."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any, Literal, Unpack, get_type_hints

from gymnasium.vector import AutoresetMode

from rcs.devices import Arm, Camera, CameraMode, Gripper, Hand, lookup
from rcs.envs.assemble import assemble, assemble_vec
from rcs.envs.env import Env
from rcs.envs.gates.gate import Gate
from rcs.envs.layers import Layer
from rcs.envs.observer import Observer
from rcs.envs.parts import Parts
from rcs.envs.setup import Options, Setup
from rcs.envs.task import Task
from rcs.envs.vector import VecEnv
from rcs.errors import InvalidSetup, UnknownName
from rcs.hardware.site import DeviceAddress, Devices, Site
from rcs.kinematics.damping import damped
from rcs.robots.compliance import Compliance
from rcs.robots.description import ArmDescription, CameraDescription, GripperDescription, HandDescription
from rcs.robots.tactile import TactileDescription
from rcs.setups.calibration import calibrated
from rcs.setups.lab import Lab, Stand, lab_of
from rcs.sim.own_cameras import cameras_of
from rcs.sim.scene import CameraPlacement, RobotPlacement
from rcs.sim.tactile_mounts import TactilePlacement, on_pads
from rcs.sim.world import require_count
from rcs.tasks.distractors import Distractors

NO_END_EFFECTOR = "none"
"""Asks for a bare flange."""

RENDER_MODES = (None, "rgb_array", "rgb_array_list", "human")

AnyLayer = Layer | type[Layer] | str
"""A layer, its class, the name of its entry point, or `module:Class`."""

AnyGate = Gate | type[Gate] | str
AnyGates = Sequence[AnyGate] | Mapping[str, Mapping[str, Any]]
"""Gates, their classes, or their names, in the order in which targets pass them; or options by name."""

Hardware = str | Path | DeviceAddress | Arm | Gripper | Hand | Camera
"""A device, or how it is reached."""


def make(
    task: str | type[Task] | Setup = "PickCuboid",
    *,
    hardware: Site | Hardware | Mapping[str, Hardware] | None = None,
    layers: Sequence[AnyLayer] | Mapping[str, Sequence[AnyLayer]] = (),
    gates: AnyGates = (),
    observers: Sequence[Observer] = (),
    render_mode: Literal["rgb_array", "rgb_array_list", "human"] | None = None,
    **options: Unpack[Options],
) -> Env:
    """Make an environment, simulated, real, or some of each.

    Args:
        task: A task by name, as a class or as `module:Class`; or a whole setup.
        hardware: What is real: a `Site` or the path of its file, `driver:address` for all arms with their end
            effectors, or a mapping from names of robots, cameras and tactile sensors to addresses or devices. All else
            is simulated, in real time and in one world. None for simulation alone.
        layers: Your own layers on top of those of the setup, from the lowest to the highest, as objects, classes or
            names; of several robots, a sequence per robot by name. Names and classes in a sequence, up to its first
            object, become part of the setup, which recordings keep; replays go without the others.
        gates: What the targets of all robots must pass before a device sees them: objects, classes or names, or a
            mapping from names to options, such as `{"Guard": {"on_hit": "clip"}}`. Names and classes up to the first
            object become part of the setup.
        observers: See every step.
        render_mode: `rgb_array` for an environment whose `render` draws, `rgb_array_list` for one that draws every
            step, `human` for a window; None for none.
        options: Fields of `Setup`; their defaults and units are listed there.

    Raises:
        UnknownName: A task, robot, end effector, camera, layer or driver that does not exist.
        InvalidSetup: An option that does not make sense.

    Example:
        >>> import rcs
        >>> env = rcs.make("PickCuboid", robot="fr3", control="joints", relative=True, frequency=30)
        >>> observation, info = env.reset(seed=0)
        >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    """
    if render_mode not in RENDER_MODES:
        raise InvalidSetup(f"render_mode is {render_mode!r}; valid: {', '.join(map(repr, RENDER_MODES))}.")
    parts = _parts(_setup(task, dict(options)), layers, gates)
    parts = replace(parts, devices=_devices(hardware, parts), observers=list(observers))
    return assemble(parts, render_mode=render_mode)


def make_vec(
    task: str | type[Task] | Setup = "PickCuboid",
    *,
    copies: int = 2,
    threads: int = 0,
    autoreset: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    layers: Sequence[AnyLayer] | Mapping[str, Sequence[AnyLayer]] = (),
    gates: AnyGates = (),
    render_mode: None = None,
    **options: Unpack[Options],
) -> VecEnv:
    """Make many copies of an environment that are stepped together on native threads.

    Args:
        task: A task by name, as a class or as `module:Class`; or a whole setup.
        copies: Number of copies.
        threads: Threads for physics and rendering, 0 for one per CPU.
        autoreset: When a copy starts its next episode: `NextStep`, `SameStep` or `Disabled` (gymnasium's).
        layers: Your own layers, as in `make`.
        gates: As in `make`; a guard of copies must have `on_hit="clip"`.
        render_mode: None: copies have `cameras`, and nothing else that draws.
        options: Fields of `Setup`; their defaults and units are listed there.

    Raises:
        UnknownName: A task, robot, end effector or camera that does not exist.
        InvalidSetup: An option that does not make sense.

    Example:
        >>> import rcs
        >>> envs = rcs.make_vec("PickCuboid", copies=24, robot="fr3")
        >>> observations, infos = envs.reset(seed=0)
    """
    require_count("copies", copies, 1)
    require_count("threads", threads, 0)
    copies, threads = int(copies), int(threads)
    if render_mode is not None:  # pyright: ignore[reportUnnecessaryComparison]
        raise InvalidSetup(
            f"render_mode is {render_mode!r}, and copies draw no pictures besides those of their cameras; give "
            "cameras=(...) for frames in the observation, or film one environment: rcs.make(..., render_mode=...)."
        )
    setup = _setup(task, dict(options))
    if setup.stepping == "realtime":
        raise InvalidSetup("Copies have no common wall clock; use stepping='async' or 'sync'.")
    try:
        mode = AutoresetMode(autoreset)
    except ValueError as err:
        valid = ", ".join(repr(one.value) for one in AutoresetMode)
        raise InvalidSetup(f"autoreset is {autoreset!r}; valid: {valid}.") from err
    return assemble_vec(_parts(setup, layers, gates), copies=copies, threads=threads, autoreset=mode)


def _setup(task: str | type[Task] | Setup, options: dict[str, Any]) -> Setup:
    if isinstance(task, Setup):
        if options:
            raise InvalidSetup(f"A setup was given and also {sorted(options)}; use dataclasses.replace on the setup.")
        return task
    return Setup.from_json({"task": lookup.name_of("task", task), **options})


def _parts(setup: Setup, layers: Sequence[AnyLayer] | Mapping[str, Sequence[AnyLayer]], gates: AnyGates) -> Parts:
    """Return what a setup names, with the user's layers and gates: those that have a name in the setup itself."""
    if isinstance(gates, str):
        raise InvalidSetup(f"gates is the text {gates!r}; give a sequence, such as [{gates!r}].")
    if not isinstance(gates, Mapping):
        by_name = {lookup.name_of("gate", gate): {} for gate in takewhile(_has_name, gates)}
        own_gates, gates = list(gates)[len(by_name) :], by_name
    else:
        own_gates = []
    setup = replace(setup, gates={**setup.gates, **gates})
    if isinstance(layers, str):
        raise InvalidSetup(f"layers is the text {layers!r}; give a sequence, such as [{layers!r}].")
    if not isinstance(layers, Mapping):
        named = [lookup.name_of("layer", layer) for layer in takewhile(_has_name, layers)]
        setup, layers = replace(setup, layers=(*setup.layers, *named)), list(layers)[len(named) :]
    parts = resolve(setup)
    robots = [robot.name for robot in parts.robots]
    own = _layers(layers if isinstance(layers, Mapping) else dict.fromkeys(robots, layers), robots)
    return replace(
        parts,
        layers={name: [*parts.layers[name], *own.get(name, ())] for name in robots},
        gates=[*parts.gates, *(_one("gate", gate, Gate) for gate in own_gates)],
    )


def _has_name(layer: AnyLayer | AnyGate) -> bool:
    """Return whether a layer or gate is found again by its name; one that is defined inside of a function is not."""
    return isinstance(layer, str) or (isinstance(layer, type) and "<locals>" not in layer.__qualname__)


def _layers(given: Mapping[str, Sequence[AnyLayer]], robots: Sequence[str]) -> dict[str, list[Layer]]:
    """Return the user's layers by robot, made where they are classes or names."""
    if unknown := sorted(set(given) - set(robots)):
        raise UnknownName("robot of this setup", unknown[0], robots)
    made = {name: [_one("layer", layer, Layer) for layer in own] for name, own in given.items()}
    every = [id(layer) for own in made.values() for layer in own]
    if len(set(every)) != len(every):
        raise InvalidSetup("A layer remembers the targets of one robot; give each robot its own, or the layer's class.")
    return made


def _one(kind: Literal["layer", "gate"], given: Any, wanted: type[Any]) -> Any:
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
        raise InvalidSetup(f"The gate {name!r} does not take {sorted(options)}; valid options: {valid}.") from err


def site_of(setup: Setup, hardware: Any) -> Site:
    """Return the site that `hardware` of `make` stands for in a setup; nothing is connected.

    Raises:
        InvalidSetup: It is none of what is valid there.
        UnknownName: A name in it, or in the setup, does not exist.
    """
    return _site(hardware, resolve(setup))


def _site(hardware: Any, parts: Parts) -> Site:
    robots = {robot.name: (robot.arm, robot.end_effector) for robot in parts.robots}
    return Site.of(hardware, robots, [one.name for one in parts.cameras], [one.name for one in parts.tactile])


def _devices(hardware: Any, parts: Parts) -> Devices:
    if hardware is None:
        return Devices()
    robots = {robot.name: (robot.arm, robot.end_effector) for robot in parts.robots}
    cameras = {camera.name: (camera.camera, _mode(parts.setup, camera)) for camera in parts.cameras}
    tactile = {sensor.name: sensor.sensor for sensor in parts.tactile}
    compliance = {robot.name: robot.compliance for robot in parts.robots if robot.compliance is not None}
    return _site(hardware, parts).devices(robots, cameras, tactile, compliance)


def _mode(setup: Setup, camera: CameraPlacement) -> CameraMode:
    """Return the mode of a real camera that frames of a setup are cut out of: the smallest that is large enough."""
    width, height = setup.size_of(camera.name)
    rate = camera.camera.frame_rate((width, height), setup.fps_of(camera.name))
    large = [
        mode for mode in camera.camera.modes if mode.width >= width and mode.height >= height and rate in mode.rates
    ]
    large = large or [mode for mode in camera.camera.modes if rate in mode.rates]
    mode = min(large, key=lambda mode: mode.width * mode.height)
    return CameraMode(mode.width, mode.height, rate, setup.depth)


def _show_options(function: Callable[..., Any]) -> None:
    """Have `help` and `inspect.signature` show the fields of `Setup` with their defaults, not `**options`."""
    shown = inspect.signature(function, eval_str=True)
    usual = Setup()
    own = [one for one in shown.parameters.values() if one.kind is not one.VAR_KEYWORD]
    more = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=getattr(usual, name), annotation=hint)
        for name, hint in get_type_hints(Options).items()
    ]
    vars(function)["__signature__"] = shown.replace(parameters=[*own, *more])


_show_options(make)
_show_options(make_vec)


def resolve(setup: Setup) -> Parts:
    """Look up everything that a setup names.

    Raises:
        UnknownName: A name that does not exist; the message has the nearest match.
        InvalidSetup: Parts that do not fit each other.
    """
    lab = lab_of(setup.robot)
    if setup.calibration is not None:
        lab = calibrated(lab, setup.calibration)
    task: Any = lookup.find("task", setup.task)
    if not (isinstance(task, type) and issubclass(task, Task)):
        raise InvalidSetup(f"{setup.task!r} is {task!r}; valid is a subclass of rcs.envs.task.Task.")
    names = [stand.name for stand in lab.stands]
    if isinstance(setup.end_effector, Mapping) and (unknown := sorted(setup.end_effector.keys() - set(names))):
        raise UnknownName("robot of this setup", unknown[0], names)
    robots = tuple(
        _place(one, setup.end_effector_of(one.name) or lab.end_effector, setup.compliance) for one in lab.stands
    )
    cameras = tuple(_mount(name, setup, lab, robots) for name in setup.cameras)
    tactile = tuple(sensor for robot in robots for sensor in _feel(setup.tactile, robot))
    count = 0 if setup.randomisation is None else setup.randomisation.distractors
    return Parts(
        setup=setup,
        robots=robots,
        cameras=cameras,
        tactile=tactile,
        task=task(lab.area, setup.task_options),
        clutter=Distractors(count, scale=lab.area.object_scale) if count else None,
        layers=_layers(dict.fromkeys(names, setup.layers), names),
        gates=[_gate(name, options) for name, options in setup.gates.items()],
    )


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
        raise UnknownName(f"camera in the lab of {setup.robot!r}", name, {*lab.cameras, *own})
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
        name=name,
        camera=description,
        parent_body=parent,
        optical_in_parent=mount.optical,
        calibration=mount.calibration,
    )
