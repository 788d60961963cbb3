"""An object in a gripper stays where it is held, and one that falls on the table does not sink into it."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.devices import lookup
from rcs.envs.task import Area
from rcs.robots.description import ArmDescription, GripperDescription
from rcs.setups.lab import lab_of
from rcs.sim.robot import SimRobot
from rcs.sim.scene import RobotPlacement, Scene
from rcs.sim.world import World
from rcs.spatial import Pose, wxyz_to_xyzw, xyzw_to_wxyz
from rcs.tasks.pick_cuboid import CUBOID, PickCuboid

GRASP_TIME = 2.0
"""Time for the slowest gripper to close, and for the cuboid to come to rest in it [s]."""
SWING = 1.0
"""Turn of the first joint, there and back [rad]."""
SPEED = 1.0
"""Mean speed of the swing; the largest is half as much again [rad/s]."""


@dataclass
class Grasp:
    """An arm at home that holds the cuboid of its lab."""

    world: World
    robot: SimRobot

    def cuboid_in_tcp(self) -> Pose:
        """Return where the cuboid is in the hand."""
        data = self.world.data
        assert data is not None
        body = data.body(CUBOID)
        return _tcp(self).inverse() * Pose(body.xpos, wxyz_to_xyzw(body.xquat))

    def go(self, duration: float) -> None:
        """Let time pass [s]."""
        for _ in range(round(duration / self.world.period)):
            self.world.advance()


def _tcp(grasp: Grasp) -> Pose:
    assert grasp.world.data is not None
    site = grasp.world.data.site(grasp.robot.layout.tcp_site)
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, site.xmat)
    return Pose(site.xpos, wxyz_to_xyzw(quaternion))


def grasp(name: str) -> Grasp:
    """Close the gripper of a lab around a cuboid that floats at its TCP until it is held."""
    lab = lab_of(name)
    (stand,) = lab.stands
    arm = lookup.find("arm", stand.arm)
    gripper = lookup.find("gripper", lab.end_effector or "")
    assert isinstance(arm, ArmDescription)
    assert isinstance(gripper, GripperDescription)
    placement = RobotPlacement(name="robot", arm=arm, gripper=gripper, base_in_scene=stand.base_in_scene)
    scene = Scene.empty()
    PickCuboid(lab.area).furnish(scene)
    scene.add_robot(placement)
    scene.spec.body(CUBOID).gravcomp = 1.0
    world = World(scene.compile())
    held = Grasp(world, SimRobot(world, placement))
    held.robot.go_home()
    world.refresh()
    # Its shorter edge along the TCP's y axis, in which the fingers close.
    assert world.data is not None
    tcp = _tcp(held)
    world.data.joint(CUBOID).qpos[:] = [*tcp.translation, *xyzw_to_wxyz(tcp.quaternion)]
    held.robot.command_opening(np.zeros(1))
    held.go(GRASP_TIME)
    world.model.body_gravcomp[world.model.body(CUBOID).id] = 0.0
    held.go(0.5)
    return held


def swing(duration: float, time: float) -> float:
    """Return the turn after a time of a swing there and back with a smooth speed [rad]."""
    return SWING / 2 * (1.0 - np.cos(2.0 * np.pi * time / duration))


@pytest.mark.parametrize("name", ["fr3", "ur5e", "so101"])
def test_a_held_cuboid_creeps_less_than_a_millimetre_while_the_arm_swings(name: str) -> None:
    held = grasp(name)
    world, robot = held.world, held.robot
    before = held.cuboid_in_tcp()
    duration = 2.0 * SWING / SPEED
    home = np.array(robot.placement.arm.home)
    turned = []
    for step in range(round(duration / world.period)):
        robot.command_joints(home + np.eye(len(home))[0] * swing(duration, (step + 1) * world.period))
        world.advance()
        turned.append(robot.joints[0] - home[0])
    assert max(turned) > 0.9 * SWING
    robot.command_joints(home)
    held.go(1.0)
    moved = before.inverse() * held.cuboid_in_tcp()
    assert np.linalg.norm(moved.translation) < 1e-3
    assert np.linalg.norm(moved.rotvec) < np.deg2rad(3.0)


def depths(model: mujoco.MjModel, data: mujoco.MjData, steps: int) -> NDArray[np.float64]:
    """Return how deep contacts are in each step [m]."""
    deepest = np.zeros(steps)
    for step in range(steps):
        mujoco.mj_step(model, data)
        deepest[step] = -min((contact.dist for contact in data.contact), default=0.0)
    return deepest


def test_a_cuboid_that_is_dropped_hardly_sinks_into_the_table() -> None:
    scene, task = Scene.empty(), PickCuboid(Area())
    task.furnish(scene)
    model = scene.compile()
    data = mujoco.MjData(model)
    data.joint(CUBOID).qpos[2] = 0.3 + task.edges[2] / 2
    depth = depths(model, data, round(1.0 / model.opt.timestep))
    assert 0.0 < depth.max() < 5e-3
    assert depth[-1] < 1e-4
