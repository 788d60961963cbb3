"""From resolved parts to an environment, in one readable place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from gymnasium.vector import AutoresetMode

from rcs.envs.clock import SimClock
from rcs.envs.env import Env
from rcs.envs.layers import BinaryGripper, CartesianControl, Layer, LimitStep, Relative, XyzrpyControl
from rcs.envs.ports import Port
from rcs.envs.scenario import Scenario
from rcs.envs.setup import Setup
from rcs.envs.sim_ports import SimArmPort, SimCameraPort, SimGripperPort
from rcs.envs.spaces import TQUAT, XYZRPY
from rcs.envs.stack import Stack
from rcs.envs.task import Task
from rcs.envs.vector import VecEnv
from rcs.kinematics import kinematics_of
from rcs.sim.camera import SimCameras
from rcs.sim.picture import Picture
from rcs.sim.robot import SimRobot
from rcs.sim.scene import CameraPlacement, RobotPlacement, Scene
from rcs.sim.world import World


@dataclass(frozen=True, kw_only=True)
class Parts:
    """What a setup names, looked up."""

    setup: Setup
    """The setup itself: numbers and options."""
    robots: tuple[RobotPlacement, ...]
    cameras: tuple[CameraPlacement, ...]
    task: Task


def assemble(parts: Parts, *, has_picture: bool = False, is_blind: bool = False) -> Env:
    """Put one simulated environment together.

    Args:
        parts: What it is made of.
        has_picture: Whether `render` draws.
        is_blind: Leave the cameras in the scene, whose state they are part of, but observe no frames.
    """
    setup = parts.setup
    world = World(compose(parts).compile(), frequency=setup.frequency, mode=setup.mode)
    scenario, stack = _populate(parts, world, is_blind=is_blind)
    return Env(
        stack,
        SimClock(world),
        scenario,
        max_episode_steps=setup.max_episode_steps,
        picture=Picture(world) if has_picture else None,
        title=f"rcs {setup.task} with {setup.robot}",
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
    scene = Scene.empty(physics_step=parts.setup.physics_step)
    parts.task.furnish(scene)
    for robot in parts.robots:
        scene.add_robot(robot)
    for camera in parts.cameras:
        scene.add_camera(camera)
    return scene


def _populate(parts: Parts, world: World, *, is_blind: bool = False) -> tuple[Scenario, Stack]:
    setup = parts.setup
    robot = SimRobot(world, parts.robots[0])
    if setup.mode == "sync":
        robot.wait_for_arrival()
    scenario = Scenario(world, [robot], parts.task)
    ports: list[Port] = [SimArmPort(robot)]
    if robot.placement.gripper is not None:
        ports.append(SimGripperPort(robot))
    if parts.cameras and not is_blind:
        cameras = SimCameras(world, list(parts.cameras), size=setup.size, has_depth=setup.depth, quality=setup.quality)
        ports.append(SimCameraPort(cameras))
    return scenario, Stack(ports, layers_of(setup, robot.placement), world.leading)


def layers_of(setup: Setup, robot: RobotPlacement) -> list[Layer]:
    """Return the layers that a setup asks for, from the lowest to the highest."""
    # What an arm can do in one period; a synchronous step lasts as long as it needs, so there the range is the bound.
    step = np.array(robot.arm.velocity_limit) / setup.frequency
    control = setup.control
    layers: list[Layer] = []
    if setup.mode != "sync":
        layers.append(LimitStep(step))
    if control in (TQUAT, XYZRPY):
        layers.append(CartesianControl(kinematics_of(robot.arm, robot.gripper)))
    if setup.relative != "absolute":
        layers.append(Relative(control, to=setup.relative, max_joint_step=step))
    elif control == XYZRPY:
        layers.append(XyzrpyControl())
    if robot.gripper is not None and setup.binary_gripper:
        layers.append(BinaryGripper())
    return layers
