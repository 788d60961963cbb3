from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.robots.cameras import REALSENSE_D405
from rcs.robots.compliance import Compliance
from rcs.robots.description import Mount
from rcs.robots.fr3 import FR3
from rcs.sim import CameraPlacement, RobotPlacement, Scene, World
from rcs.sim.robot import RobotLayout, SimRobot


def test_an_empty_scene_has_a_floor_lights_and_an_overview() -> None:
    model = Scene.empty(physics_step=0.001).compile()
    assert model.opt.timestep == 0.001
    assert model.nlight > 0
    assert model.camera("overview").id == 0


def test_two_robots_of_one_kind_stand_side_by_side(placement: RobotPlacement) -> None:
    scene = Scene.empty()
    left = RobotPlacement(
        name="left", arm=FR3, gripper=placement.gripper, base_in_scene=Mount(translation=(0.0, 0.5, 0.0))
    )
    right = RobotPlacement(
        name="right", arm=FR3, gripper=placement.gripper, base_in_scene=Mount(translation=(0.0, -0.5, 0.0))
    )
    scene.add_robot(left)
    scene.add_robot(right)
    model = scene.compile()
    layouts = [RobotLayout.of(robot, model) for robot in (left, right)]
    assert not set(layouts[0].joint_ids) & set(layouts[1].joint_ids)
    assert not set(layouts[0].actuator_ids) & set(layouts[1].actuator_ids)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    offset = data.site(left.tcp_site).xpos - data.site(right.tcp_site).xpos
    np.testing.assert_allclose(offset, [0.0, 1.0, 0.0], atol=1e-12)


def test_a_name_is_given_once(placement: RobotPlacement) -> None:
    scene = Scene.empty()
    scene.add_robot(placement)
    with pytest.raises(InvalidSetup, match="Two robots are named 'fr3'"):
        scene.add_robot(placement)
    camera = CameraPlacement(name="wrist", camera=REALSENSE_D405, parent_body="world", optical_in_parent=Mount())
    scene.add_camera(camera)
    with pytest.raises(InvalidSetup, match="Two cameras are named 'wrist'"):
        scene.add_camera(camera)


def test_a_camera_needs_a_body_to_be_mounted_on() -> None:
    camera = CameraPlacement(name="wrist", camera=REALSENSE_D405, parent_body="nobody", optical_in_parent=Mount())
    with pytest.raises(InvalidSetup, match="'nobody', which is not in the scene"):
        Scene.empty().add_camera(camera)


def test_a_mounted_camera_looks_along_the_z_axis_of_its_optical_frame() -> None:
    scene = Scene.empty()
    turned = Mount(translation=(0.1, 0.2, 0.3), quaternion=(0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)))
    scene.add_camera(CameraPlacement(name="eye", camera=REALSENSE_D405, parent_body="world", optical_in_parent=turned))
    model = scene.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    camera = data.camera("eye/" + REALSENSE_D405.camera)
    np.testing.assert_allclose(camera.xpos, [0.1, 0.2, 0.3], atol=1e-9)
    # MuJoCo's cameras look along -z with y up; the optical frame's z is forward and its y is down.
    axes = camera.xmat.reshape(3, 3)
    np.testing.assert_allclose(-axes[:, 2], [1.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(-axes[:, 1], [0.0, 1.0, 0.0], atol=1e-9)


def test_a_camera_on_the_axis_of_a_moving_body_has_no_bracket(placement: RobotPlacement) -> None:
    scene = Scene.empty()
    scene.add_robot(placement)
    above = Mount(translation=(0.0, 0.0, 0.2))
    camera = CameraPlacement(name="eye", camera=REALSENSE_D405, parent_body="fr3/link7", optical_in_parent=above)
    scene.add_camera(camera)
    scene.compile()


def test_a_robot_that_is_refused_leaves_the_scene_as_it_was(placement: RobotPlacement) -> None:
    scene = Scene.empty()
    with pytest.raises(InvalidSetup, match="joints has 6 numbers"):
        scene.add_robot(replace(placement, compliance=Compliance(joints=(100.0,) * 6)))
    scene.add_robot(placement)
    scene.compile()


def test_a_robot_at_home_stays_at_home(placement: RobotPlacement) -> None:
    scene = Scene.empty()
    scene.add_table()
    scene.add_robot(placement)
    model = scene.compile()
    robot = SimRobot(World(model), placement)
    robot.go_home()
    for _ in range(30):
        robot.world.advance()
    np.testing.assert_allclose(robot.joints, placement.arm.home, atol=1e-3)


def test_joints_that_are_not_neighbours_are_still_found(placement: RobotPlacement) -> None:
    scene = Scene.empty()
    scene.add_robot(placement)
    # A joint between the arm's: its positions are then no longer side by side.
    scene.spec.body("fr3/link3").add_joint(name="extra", type=mujoco.mjtJoint.mjJNT_HINGE)
    model = scene.compile()
    layout = RobotLayout.of(placement, model)
    assert isinstance(layout.qpos, np.ndarray)
    world = World(model, copies=2)
    world.qpos[..., layout.qpos] = placement.arm.home
    np.testing.assert_array_equal(world.qpos[..., layout.qpos], [placement.arm.home] * 2)
    assert world.qpos[0, model.joint("extra").qposadr[0]] == 0.0
