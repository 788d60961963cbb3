"""From resolved parts to an environment, in one readable place."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

from gymnasium.vector import AutoresetMode

from rcs.envs import spaces as keys
from rcs.envs.control_layers import layers_of, limit_step, native_space, require_native
from rcs.envs.env import Env
from rcs.envs.layers import LateActions, Layer, PointClouds, WristCamera
from rcs.envs.parts import Parts
from rcs.envs.ports.camera import CameraPort, FreshFrames
from rcs.envs.ports.loads import PrivilegedPort, SimContactPort, SimLoadPort
from rcs.envs.ports.port import ArmPort, EffectorPort, Port, is_streamed
from rcs.envs.ports.simulated import PixelPort, SimArmPort, SimCameraPort, SimEffectorPort, SimTactilePort
from rcs.envs.setup import Setup
from rcs.envs.start import base_in_scene
from rcs.envs.step.chain import Chain
from rcs.envs.step.clock import Clock
from rcs.envs.step.simulation import Simulation
from rcs.envs.step.stack import NAMELESS, Stack
from rcs.envs.variation.randomiser import Randomiser
from rcs.envs.variation.robots import keep_history
from rcs.envs.vector import VecEnv
from rcs.errors import InvalidSetup
from rcs.kinematics import kinematics_of
from rcs.sim.camera import SimCameras
from rcs.sim.camera_feed import FrameClock, FrameRate
from rcs.sim.loads import CollisionGuard
from rcs.sim.robot import SimRobot
from rcs.sim.scene import CameraPlacement, RobotPlacement, Scene
from rcs.sim.tactile import SimTactile
from rcs.sim.textures import add_textures
from rcs.sim.viewer import Picture
from rcs.sim.world import World
from rcs.spatial import Pose, inverse, tquat_to_matrix

VALID_PERIODS = 3.0
"""A command without another is valid for as many control periods, when nothing else is said."""
SLOW_READ = 0.5
"""A gripper or hand that takes a larger share of a control period to read is read on a thread."""


def assemble(parts: Parts, *, render_mode: str | None = None, drawn: Sequence[str] | None = None) -> Env:
    """Put one environment together, simulated, real, or some of each.

    Args:
        parts: Its parts.
        render_mode: Mode of `render`; None for nothing.
        drawn: Names of the cameras to observe, in this order; None for all. The others stay in the scene, whose state
            they are part of.

    Raises:
        InvalidSetup: Synchronous steps of simulated and real devices together, or pictures without a simulation.
    """
    setup, devices = parts.setup, parts.devices
    by_name = {camera.name: camera for camera in parts.cameras}
    cameras = [by_name[name] for name in (by_name if drawn is None else drawn)]
    world: World | None = None
    if not _is_all_real(parts, cameras):
        if devices and setup.stepping == "sync":
            raise InvalidSetup("Synchronous steps are of simulated or of real devices alone; use stepping='realtime'.")
        world = World(
            compose(parts).compile(), frequency=setup.frequency, stepping="realtime" if devices else setup.stepping
        )
    elif render_mode is not None:
        raise InvalidSetup("Real devices have no picture to render; use the frames of a camera.")
    simulation, stack = _populate(parts, world, cameras)
    picture = None if render_mode is None or world is None else Picture(world, quality=setup.render_quality)
    effectors = [f"{robot.name}/{robot.end_effector.name}" for robot in parts.robots if robot.end_effector is not None]
    simulated = [robot.name for robot in parts.robots] + effectors
    simulated += [sensor.name for sensor in (*cameras, *parts.tactile)]
    return Env(
        stack,
        Clock(
            world,
            stack.ports if devices else (),
            frequency=setup.frequency,
            is_real=bool(devices) or setup.stepping == "realtime",
            is_synchronous=setup.stepping == "sync",
            time_limit=setup.sync_time_limit,
            now=parts.now,
            sleep=parts.sleep,
        ),
        simulation,
        setup=setup,
        robots=parts.robots,
        platform={**dict.fromkeys(simulated, "simulation"), **devices.platform},
        site=devices.site,
        instruction=parts.task.instruction,
        max_episode_steps=setup.max_episode_steps,
        observers=parts.observers,
        picture=picture,
        render_mode=render_mode,
        title=setup.title,
    )


def assemble_vec(parts: Parts, *, copies: int, threads: int, autoreset: AutoresetMode) -> VecEnv:
    """Put many copies of a simulated environment together."""
    setup = parts.setup
    model = compose(parts).compile()
    world = World(model, copies=copies, threads=threads, frequency=setup.frequency, stepping=setup.stepping)
    simulation, stack = _populate(parts, world, parts.cameras)
    assert simulation is not None, "there is a world"
    return VecEnv(stack, Clock(world), simulation, setup=setup, autoreset=autoreset)


def compose(parts: Parts) -> Scene:
    """Put the scene together: furniture, robots, cameras."""
    scene = Scene.empty(physics_step=parts.setup.physics_step, has_textures=parts.setup.render_quality == "full")
    parts.task.furnish(scene)
    if parts.clutter is not None:
        parts.clutter.furnish(scene)
    for name, obstacle in parts.obstacles.items():
        scene.add_obstacle(name, obstacle)
    for robot in _bodies(parts):
        scene.add_robot(robot, assets=parts.setup.assets)
    parts.task.equip(scene, parts.robots)
    for camera in parts.cameras:
        scene.add_camera(camera)
    for sensor in parts.tactile:
        scene.add_tactile(sensor)
    if parts.setup.randomisation is not None:
        add_textures(scene.spec, parts.setup.randomisation.textures)
        if parts.setup.randomisation.varies("action_latency"):
            keep_history(scene.spec, parts.robots, parts.setup.randomisation.action_latency[1])
        scene.varied = parts.setup.randomisation.fields
    return scene


def _bodies(parts: Parts) -> list[RobotPlacement]:
    """Return the robots of the scene; the body of a real arm follows it, and does not give way itself."""
    real = parts.devices.arms
    return [replace(robot, compliance=None) if robot.name in real else robot for robot in parts.robots]


def _is_all_real(parts: Parts, cameras: Sequence[CameraPlacement]) -> bool:
    devices = parts.devices
    return (
        all(sensor.name in devices.tactile for sensor in parts.tactile)
        and all(robot.name in devices.arms for robot in parts.robots)
        and all(robot.end_effector is None or robot.name in devices.effectors for robot in parts.robots)
        and all(camera.name in devices.cameras for camera in cameras)
    )


def _populate(parts: Parts, world: World | None, cameras: Sequence[CameraPlacement]) -> tuple[Simulation | None, Stack]:
    """Return the simulated part, if there is one, and the stack over all parts."""
    setup, devices = parts.setup, parts.devices
    if "privileged" in setup.observe and devices:
        raise InvalidSetup("Poses of objects are known in simulation only; leave 'privileged' out of observe.")
    require_native(parts)
    leading = () if world is None else world.leading
    simulated = [camera for camera in cameras if camera.name not in devices.cameras]
    real = [camera for camera in cameras if camera.name in devices.cameras]
    simulation: Simulation | None = None
    shared: list[Port] = []
    bodies: dict[str, SimRobot] = {}
    randomiser: Randomiser | None = None
    if world is not None:
        bodies = {placement.name: SimRobot(world, placement) for placement in _bodies(parts)}
        if setup.stepping == "sync":
            for robot in bodies.values():
                robot.wait_for_arrival(0.0 if setup.randomisation is None else setup.randomisation.action_latency[1])
        clock = _frame_clock(setup, simulated, world) if simulated else None
        if (ranges := setup.randomisation) is not None:
            objects = parts.task.objects()
            randomiser = Randomiser(world, ranges, objects=objects, robots=parts.robots, cameras=parts.cameras)
        robots = list(bodies.values())
        simulation = Simulation(
            world, robots, parts.task, randomiser, clock, parts.clutter, reward=setup.reward, discount=setup.discount
        )
        simulation.guards = _guards(parts, bodies)
        shared += _simulated_sensors(parts, simulated, world, robots, clock, randomiser)
    gates = list(parts.gates)
    for gate in gates:
        gate.bind(parts, world, partial(compose, parts))
    if real and setup.cameras.segmentation:
        raise InvalidSetup(
            f"Real cameras ({', '.join(camera.name for camera in real)}) have no segmentation; use segmentation=False."
        )
    if real and setup.cameras.pixels is not None:
        raise InvalidSetup(
            f"Real cameras ({', '.join(camera.name for camera in real)}) give pictures, not pixels for learners; leave "
            "pixels out of the setup."
        )
    if setup.cameras.points and (moving := [camera.name for camera in real if not _has_pose(camera, parts)]):
        raise InvalidSetup(
            f"Real cameras that move ({', '.join(moving)}) have no extrinsics, and so no points, but for that on the "
            "gripper of an only robot; use points=False, or leave them out."
        )
    points = [PointClouds()] if setup.cameras.points else []
    views = [_real_cameras(parts, real)] if real or devices.tactile else []
    shared += views
    if devices.on_stale == "hold":
        gates += [FreshFrames(port) for port in views]
    chains: dict[str, Chain] = {}
    for placement in parts.robots:
        name = placement.name
        ports = _ports_of(parts, placement, bodies.get(name))
        threads = 1 if world is None else world.core.threads
        layers = layers_of(setup, placement, threads=threads, is_native=setup.native and name in devices.arms)
        if randomiser is not None and not devices:
            layers = [*_late_actions(randomiser, setup, leading), *layers]
        if len(parts.robots) == 1:
            name, ports = NAMELESS, [*ports, *shared]
            poses = {camera.name: _in_tcp(camera, placement) for camera in real}
            mounts = [WristCamera(camera, pose) for camera, pose in poses.items() if pose is not None]
            layers = [*mounts, *points, *layers]
        chains[name] = Chain(ports, [*layers, *parts.layers.get(placement.name, ())], leading)
    if len(parts.robots) != 1:
        chains[NAMELESS] = Chain(shared, points, leading)
    return simulation, Stack(chains, gates)


def _guards(parts: Parts, bodies: Mapping[str, SimRobot]) -> dict[str, CollisionGuard]:
    """Have the arms that are simulated react to collisions, each at its own limits."""
    if not parts.setup.collision_reaction:
        return {}
    return {
        name: CollisionGuard(body, body.placement.arm.collision)
        for name, body in bodies.items()
        if name not in parts.devices.arms and body.placement.arm.collision is not None
    }


def _ports_of(parts: Parts, placement: RobotPlacement, body: SimRobot | None) -> list[Port]:
    """Return the ports of one robot: real devices where there are any, and its body in the world for the rest."""
    devices, observed = parts.devices, parts.setup.observe
    arm, effector = devices.arms.get(placement.name), devices.effectors.get(placement.name)
    ports: list[Port] = []
    if arm is not None:
        kinematics, effort = kinematics_of(placement.arm, placement.end_effector), placement.arm.effort_limit
        limit = limit_step(placement.arm, parts.setup.frequency) if parts.setup.stepping == "sync" else None
        times = _times(parts, devices.arm_stale_after)
        if is_streamed(arm):
            arm.period = 1.0 / parts.setup.frequency
        native = native_space(parts.setup, placement.arm) if parts.setup.native else None
        ports.append(ArmPort(arm, kinematics, native=native, observed=observed, effort=effort, limit=limit, **times))
    elif body is not None:
        ports.append(SimArmPort(body))
        if keys.LOADS.keys() & set(observed):
            ports.append(SimLoadPort(body, observed))
    if effector is not None:
        times = _times(parts, devices.stale_after)
        if times and parts.setup.stepping != "sync":
            times["slow_after"] = SLOW_READ / parts.setup.frequency
        ports.append(EffectorPort(effector, **times))
    elif body is not None and placement.end_effector is not None:
        ports.append(SimEffectorPort(body))
    if "contacts" in observed:
        if body is None or effector is not None:
            raise InvalidSetup("Contacts of a real gripper are not measured; leave 'contacts' out of observe.")
        ports.append(SimContactPort(body))
    for port in ports:
        port.follower = None if port.device is None else body
    return ports


def _times(parts: Parts, stale_after: float) -> dict[str, float]:
    """Return how long commands are valid and measurements new, by the host's clock; under another one, for ever."""
    if parts.now is not None:
        return {}
    valid_for = parts.devices.valid_for
    return {
        "valid_for": VALID_PERIODS / parts.setup.frequency if valid_for is None else valid_for,
        "stale_after": stale_after,
    }


def _frame_clock(setup: Setup, cameras: Sequence[CameraPlacement], world: World) -> FrameClock:
    """Return the clock that knows when each camera has a new frame."""
    rates: dict[str, FrameRate] = {}
    for name, camera in ((one.name, one.camera) for one in cameras):
        fps = camera.frame_rate(setup.cameras.size_of(name), setup.cameras.fps_of(name))
        rates[name] = FrameRate(fps=fps, longest_exposure=camera.longest_exposure)
    return FrameClock(world, rates)


def _simulated_sensors(
    parts: Parts,
    observed: list[CameraPlacement],
    world: World,
    robots: list[SimRobot],
    clock: FrameClock | None,
    randomiser: Randomiser | None,
) -> list[Port]:
    """Return the ports of everything simulated that gives frames."""
    setup = parts.setup
    ports: list[Port] = []
    asked = setup.cameras
    if clock is not None and asked.pixels is not None:
        size, quality = asked.size_of(observed[0].name), setup.render_quality
        ports.append(PixelPort(world, observed, clock, asked.pixels, randomiser, size=size, quality=quality))
    elif clock is not None:
        cameras = SimCameras(
            world,
            observed,
            size={camera.name: asked.size_of(camera.name) for camera in observed},
            has_depth=asked.depth,
            has_segmentation=asked.segmentation,
            quality=setup.render_quality,
            has_noise=asked.noise,
            frame_body=robots[0].layout.base_body if len(robots) == 1 else 0,
        )
        ports.append(SimCameraPort(cameras, clock, randomiser))
    if felt := [sensor for sensor in parts.tactile if sensor.name not in parts.devices.tactile]:
        ports.append(SimTactilePort([SimTactile(world, sensor) for sensor in felt]))
    if "privileged" in setup.observe:
        ports.append(PrivilegedPort(world, robots, parts.task))
    return ports


def _real_cameras(parts: Parts, cameras: Sequence[CameraPlacement]) -> CameraPort:
    """Return the port of all that gives real frames; cameras in the scene or on an arm's base stand still."""
    site, setup = parts.devices, parts.setup
    scene_in_frame = tquat_to_matrix(inverse(base_in_scene(parts.robots)))
    still = {robot.base_body: scene_in_frame @ robot.base_in_scene.pose.matrix for robot in parts.robots}
    still["world"] = scene_in_frame
    fixed = {
        camera.name: still[camera.parent_body] @ camera.optical_in_parent.pose.matrix
        for camera in cameras
        if camera.parent_body in still
    }
    skins = {one.name: one.sensor.frame_size for one in parts.tactile if one.name in site.tactile}
    return CameraPort(
        {**{camera.name: site.cameras[camera.name] for camera in cameras}, **site.tactile},
        {camera.name: camera.camera for camera in cameras},
        sizes={**{camera.name: setup.cameras.size_of(camera.name) for camera in cameras}, **skins},
        calibrations={camera.name: camera.calibration for camera in cameras if camera.calibration is not None},
        extrinsics=fixed,
        stale_after=site.stale_after,
        on_stale=site.on_stale,
        now=parts.now or time.perf_counter,
    )


def _in_tcp(camera: CameraPlacement, robot: RobotPlacement) -> Pose | None:
    """Return the pose of a camera in the TCP frame if it is on the base body of a gripper; else None."""
    effector = robot.end_effector
    if effector is None or camera.parent_body != robot.gripper_prefix + effector.base_body:
        return None
    return effector.tcp_in_base.pose.inverse() * camera.optical_in_parent.pose


def _has_pose(camera: CameraPlacement, parts: Parts) -> bool:
    """Return whether the pose of a real camera is known at every step."""
    if camera.parent_body in {"world", *(robot.base_body for robot in parts.robots)}:
        return True
    return len(parts.robots) == 1 and _in_tcp(camera, parts.robots[0]) is not None


def _late_actions(randomiser: Randomiser, setup: Setup, leading: tuple[int, ...]) -> list[Layer]:
    """Return the layer that has actions of a simulated robot come late now and then, if they do."""
    if not randomiser.ranges.varies("late_actions") or setup.stepping == "sync":
        return []
    late = LateActions(randomiser.ranges.late_actions, leading)
    randomiser.begin_too(late.begin)
    return [late]
