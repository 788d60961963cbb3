"""From resolved parts to an environment, in one readable place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gymnasium.vector import AutoresetMode

from rcs.envs.clock import SimClock
from rcs.envs.env import Env
from rcs.envs.group import StackGroup
from rcs.envs.layers import BinaryGripper, CartesianControl, GraspHand, Layer, LimitStep, Relative, XyzrpyControl
from rcs.envs.ports import Port
from rcs.envs.randomiser import Randomiser
from rcs.envs.scenario import Scenario
from rcs.envs.setup import Setup
from rcs.envs.sim_ports import SimArmPort, SimCameraPort, SimGripperPort, SimHandPort
from rcs.envs.spaces import TQUAT, XYZRPY
from rcs.envs.stack import Stack
from rcs.envs.tactile_port import SimTactilePort
from rcs.envs.task import Task
from rcs.envs.vector import VecEnv
from rcs.kinematics import kinematics_of
from rcs.sim.camera import SimCameras
from rcs.sim.frame_clock import FrameClock, FrameRate
from rcs.sim.picture import Picture
from rcs.sim.robot import SimRobot
from rcs.sim.scene import CameraPlacement, RobotPlacement, Scene
from rcs.sim.tactile import SimTactile
from rcs.sim.tactile_placement import TactilePlacement
from rcs.sim.textures import add_textures
from rcs.sim.world import World

GRASP = "power"
"""The grasp of a hand that is used like a gripper."""


@dataclass(frozen=True, kw_only=True)
class Parts:
    """What a setup names, looked up."""

    setup: Setup
    """The setup itself: numbers and options."""
    robots: tuple[RobotPlacement, ...]
    cameras: tuple[CameraPlacement, ...]
    tactile: tuple[TactilePlacement, ...] = ()
    task: Task


def assemble(
    parts: Parts, *, has_picture: bool = False, is_blind: bool = False, drawn: Sequence[str] | None = None
) -> Env:
    """Put one simulated environment together.

    Args:
        parts: What it is made of.
        has_picture: Whether `render` draws.
        is_blind: Leave the cameras in the scene, whose state they are part of, but observe no frames.
        drawn: Names of the cameras to observe, in this order; the others stay in the scene. None for all.
    """
    setup = parts.setup
    world = World(compose(parts).compile(), frequency=setup.frequency, mode=setup.mode)
    scenario, stack = _populate(parts, world, is_blind=is_blind, drawn=drawn)
    return Env(
        stack,
        SimClock(world),
        scenario,
        max_episode_steps=setup.max_episode_steps,
        picture=Picture(world) if has_picture else None,
        title=f"rcs {setup.task} with {setup.robot}",
        setup=setup,
    )


def assemble_vec(parts: Parts, *, copies: int, threads: int, autoreset: AutoresetMode) -> VecEnv:
    """Put many copies of a simulated environment together."""
    setup = parts.setup
    model = compose(parts).compile()
    world = World(model, copies=copies, threads=threads, frequency=setup.frequency, mode=setup.mode)
    scenario, stack = _populate(parts, world)
    return VecEnv(
        stack,
        SimClock(world),
        scenario,
        max_episode_steps=setup.max_episode_steps,
        autoreset=autoreset,
        title=f"rcs {setup.task} with {setup.robot}",
    )


def compose(parts: Parts) -> Scene:
    """Put the scene together: furniture, robots, cameras."""
    scene = Scene.empty(physics_step=parts.setup.physics_step, has_textures=parts.setup.quality == "full")
    parts.task.furnish(scene)
    for robot in parts.robots:
        scene.add_robot(robot, assets=parts.setup.assets)
    for camera in parts.cameras:
        scene.add_camera(camera)
    for sensor in parts.tactile:
        scene.add_tactile(sensor)
    if parts.setup.randomisation is not None:
        add_textures(scene.spec, parts.setup.randomisation.textures)
    return scene


def _populate(
    parts: Parts, world: World, *, is_blind: bool = False, drawn: Sequence[str] | None = None
) -> tuple[Scenario, Stack | StackGroup]:
    setup = parts.setup
    robots = [SimRobot(world, placement) for placement in parts.robots]
    if setup.mode == "sync":
        for robot in robots:
            robot.wait_for_arrival()
    by_name = {camera.name: camera for camera in parts.cameras}
    cameras = list(parts.cameras) if drawn is None else [by_name[name] for name in drawn]
    clock = _frame_clock(setup, cameras, world)
    scenario = Scenario(world, robots, parts.task, _randomiser(parts, world), clock)
    shared = [] if is_blind else _sensors_of(parts, cameras, world, robots, clock)
    if len(robots) == 1:
        stack = Stack([*_ports_of(robots[0]), *shared], layers_of(setup, robots[0].placement), world.leading)
        return scenario, stack
    stacks = {
        robot.placement.name: Stack(_ports_of(robot), layers_of(setup, robot.placement), world.leading)
        for robot in robots
    }
    return scenario, StackGroup(stacks, Stack(shared, [], world.leading))


def _frame_clock(setup: Setup, cameras: Sequence[CameraPlacement], world: World) -> FrameClock:
    """Return the clock that says when each camera has a new frame."""
    rates = {camera.name: FrameRate.of(camera.camera, setup.size, setup.fps_of(camera.name)) for camera in cameras}
    return FrameClock(world, rates)


def _sensors_of(
    parts: Parts, observed: list[CameraPlacement], world: World, robots: list[SimRobot], clock: FrameClock
) -> list[Port]:
    """Return the port of everything that gives frames, or none."""
    setup = parts.setup
    port: SimCameraPort | None = None
    if observed:
        cameras = SimCameras(
            world,
            observed,
            size=setup.size,
            has_depth=setup.depth,
            quality=setup.quality,
            has_noise=setup.camera_noise,
            frame_body=robots[0].layout.base_body if len(robots) == 1 else 0,
        )
        port = SimCameraPort(cameras, clock)
    if parts.tactile:
        return [SimTactilePort([SimTactile(world, sensor) for sensor in parts.tactile], port)]
    return [] if port is None else [port]


def _randomiser(parts: Parts, world: World) -> Randomiser | None:
    ranges = parts.setup.randomisation
    if ranges is None:
        return None
    return Randomiser(world, ranges, objects=parts.task.objects(), robots=parts.robots, cameras=parts.cameras)


def _ports_of(robot: SimRobot) -> list[Port]:
    ports: list[Port] = [SimArmPort(robot)]
    if robot.placement.gripper is not None:
        ports.append(SimGripperPort(robot))
    if robot.placement.hand is not None:
        ports.append(SimHandPort(robot))
    return ports


def layers_of(setup: Setup, robot: RobotPlacement) -> list[Layer]:
    """Return the layers that a setup asks for, from the lowest to the highest."""
    # What an arm can do in one period; a synchronous step lasts as long as it needs, so there the range is the bound.
    step = np.array(robot.arm.velocity_limit) / setup.frequency
    control = setup.control
    layers: list[Layer] = []
    if setup.mode != "sync":
        layers.append(LimitStep(step))
    if control in (TQUAT, XYZRPY):
        layers.append(CartesianControl(kinematics_of(robot.arm, robot.end_effector)))
    if setup.relative != "absolute":
        layers.append(Relative(control, to=setup.relative, max_joint_step=step))
    elif control == XYZRPY:
        layers.append(XyzrpyControl())
    if robot.gripper is not None and setup.binary_gripper:
        layers.append(BinaryGripper())
    if robot.hand is not None and setup.binary_gripper:
        layers.append(GraspHand(robot.hand.open_pose, robot.hand.grasps[GRASP]))
    return layers
