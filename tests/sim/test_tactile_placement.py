from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from rcs.errors import InvalidSetup
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.robots.tactile import DIGIT
from rcs.sim import RobotPlacement, Scene, World
from rcs.sim.robot import SimRobot
from rcs.sim.tactile import SimTactile
from rcs.sim.tactile_mounts import on_pads


def scene_with_pads(robot: RobotPlacement) -> Scene:
    """The robot with a DIGIT in the place of each pad, and a box of 40 mm that floats between them."""
    scene = Scene.empty()
    scene.add_robot(robot)
    for sensor in on_pads(robot, DIGIT):
        scene.add_tactile(sensor)
    body = scene.spec.worldbody.add_body(name="box", pos=[0.0, 0.0, 2.0], gravcomp=1.0)
    body.add_freejoint(name="box")
    body.add_geom(name="box", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.02, 0.02, 0.02], mass=0.1)
    return scene


@pytest.fixture
def model(placement: RobotPlacement) -> mujoco.MjModel:
    return scene_with_pads(placement).compile()


def test_the_gels_have_the_pads_names_and_meet_before_the_tcp(placement: RobotPlacement, model: mujoco.MjModel) -> None:
    world = World(model)
    data = world.data
    assert data is not None
    # Home, with closed fingers: both gels' foremost points are in the middle of the pads, 0.25 mm before the TCP.
    world.qpos[[model.joint(placement.prefix + joint).qposadr[0] for joint in placement.arm.joints]] = (
        placement.arm.home
    )
    world.refresh()
    tcp = data.site(placement.tcp_site).xpos
    outwards = data.site(placement.tcp_site).xmat.reshape(3, 3)[:, 2]
    for sensor in on_pads(placement, DIGIT):
        body = data.body(sensor.body_name)
        tip = body.xpos + body.xmat.reshape(3, 3) @ np.array(DIGIT.gel_center)
        np.testing.assert_allclose(tip, tcp + 0.00025 * outwards, atol=1e-9)
        assert model.geom(sensor.gel_name).bodyid[0] == model.body(sensor.body_name).id
    assert sensor.gel_name == placement.gripper_prefix + FRANKA_HAND.pad_geoms[1][0]


def test_a_closed_empty_hand_feels_nothing(placement: RobotPlacement, model: mujoco.MjModel) -> None:
    world = World(model)
    robot = SimRobot(world, placement)
    touch = [SimTactile(world, sensor) for sensor in on_pads(placement, DIGIT)]
    robot.go_home()
    robot.command_opening(np.zeros(1, np.float32))
    for _ in range(30):
        world.advance()
    for sensor in touch:
        assert float(sensor.force) == 0.0
        assert not sensor.read()["indentation"].any()


def test_what_is_grasped_is_held_and_felt_alike_on_both_sides(placement: RobotPlacement, model: mujoco.MjModel) -> None:
    world = World(model)
    robot = SimRobot(world, placement)
    left, right = (SimTactile(world, sensor) for sensor in on_pads(placement, DIGIT))
    robot.go_home()
    world.refresh()
    data = world.data
    assert data is not None
    site = data.site(placement.tcp_site)
    tcp = site.xpos.copy()
    address = model.jnt_qposadr[model.joint("box").id]
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, site.xmat)
    world.qpos[address : address + 3] = tcp
    world.qpos[address + 3 : address + 7] = quaternion
    robot.command_opening(np.zeros(1, np.float32))
    for _ in range(20):
        world.advance()
    model.body_gravcomp[model.body("box").id] = 0.0
    for _ in range(60):
        world.advance()
    np.testing.assert_allclose(data.body("box").xpos, tcp, atol=0.002)
    for sensor in (left, right):
        assert float(sensor.force) == pytest.approx(FRANKA_HAND.grasp_force, rel=0.1)
    first, second = left.read()["indentation"], right.read()["indentation"]
    assert first.max() == pytest.approx(DIGIT.max_indentation * float(left.force) / DIGIT.force_range[1], rel=0.05)
    # The fingers are half a turn apart about the direction of the fingers, so the frames are mirror images.
    np.testing.assert_allclose(first, second[::-1], atol=2e-4)


def test_one_pad_alone_can_be_replaced(placement: RobotPlacement) -> None:
    scene = Scene.empty()
    scene.add_robot(placement)
    scene.add_tactile(on_pads(placement, DIGIT)[0])
    model = scene.compile()
    assert model.geom(placement.gripper_prefix + "right_pad").bodyid[0] == model.body("fr3/gripper/right_finger").id


def test_a_sensor_is_mounted_once(placement: RobotPlacement) -> None:
    scene = scene_with_pads(placement)
    with pytest.raises(InvalidSetup, match="Two sensors are named 'fr3_left'"):
        scene.add_tactile(on_pads(placement, DIGIT)[0])


def test_a_body_or_a_pad_that_is_not_there_is_refused(placement: RobotPlacement) -> None:
    scene = Scene.empty()
    scene.add_robot(placement)
    sensor = on_pads(placement, DIGIT)[0]
    with pytest.raises(InvalidSetup, match="'thumb', which is not in the scene"):
        scene.add_tactile(replace(sensor, parent_body="thumb"))
    with pytest.raises(InvalidSetup, match=r"replace 'nail'.*left_pad"):
        scene.add_tactile(replace(sensor, replaced_pad="nail"))
    with pytest.raises(InvalidSetup, match=r"not in the scene: \['nail'\].*left_pad"):
        scene.add_tactile(replace(sensor, other_pads=("fr3/gripper/right_pad", "nail")))
    scene.add_tactile(sensor)
    scene.compile()
