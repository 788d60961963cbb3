"""DIGITs on every gripper's pads."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.robots.robotiq_2f85 import ROBOTIQ_2F85
from rcs.robots.so101 import SO101, SO101_GRIPPER
from rcs.robots.tactile import DIGIT
from rcs.robots.tilburg_hand import TILBURG_HAND
from rcs.robots.ur5e import UR5E
from rcs.robots.xarm7 import XARM7
from rcs.sim import RobotPlacement, Scene, World
from rcs.sim.gel import Gel
from rcs.sim.robot import SimRobot
from rcs.sim.tactile import SimTactile
from rcs.sim.tactile_mounts import on_pads

ROBOTS = {
    "franka_hand": RobotPlacement(name="fr3", arm=FR3, gripper=FRANKA_HAND),
    "robotiq_2f85": RobotPlacement(name="ur5e", arm=UR5E, gripper=ROBOTIQ_2F85),
    "so101_gripper": RobotPlacement(name="so101", arm=SO101, gripper=SO101_GRIPPER),
}
WITH_HAND = RobotPlacement(name="xarm7", arm=XARM7, hand=TILBURG_HAND)
GEL = Gel(DIGIT)
FOCAL = GEL.size[0] / (2.0 * math.tan(0.5 * DIGIT.camera_yfov))
"""Focal length of the sensor's camera [px]."""


@pytest.fixture(params=list(ROBOTS))
def robot(request: pytest.FixtureRequest) -> RobotPlacement:
    return ROBOTS[request.param]


class Grasp:
    """A robot with DIGITs that closes on a cuboid with edges of 20 mm, 40 mm along the fingers."""

    def __init__(self, placement: RobotPlacement) -> None:
        scene = Scene.empty()
        scene.add_robot(placement)
        for sensor in on_pads(placement, DIGIT):
            scene.add_tactile(sensor)
        body = scene.spec.worldbody.add_body(name="box", pos=[0.0, 0.0, 2.0], gravcomp=1.0)
        body.add_freejoint(name="box")
        body.add_geom(name="box", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.01, 0.01, 0.02], mass=0.05, condim=4)
        self.world = World(scene.compile())
        self.placement = placement
        self.robot = SimRobot(self.world, placement)
        self.sensors = [SimTactile(self.world, sensor) for sensor in scene.tactile]
        self.robot.go_home()
        self.world.refresh()

    @property
    def data(self) -> mujoco.MjData:
        assert self.world.data is not None
        return self.world.data

    def frames(self) -> list[NDArray[np.uint8]]:
        return [sensor.read()["rgb"] for sensor in self.sensors]

    def put_between_the_pads(self) -> None:
        """Put the box against the right gel, in the middle of it."""
        right = self.sensors[1].placement
        body = self.data.body(right.body_name)
        turn = body.xmat.reshape(3, 3)
        address = self.world.model.joint("box").qposadr[0]
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, body.xmat)
        place = body.xpos + turn @ (np.array(DIGIT.gel_center) + [0.0101, 0.0, 0.0])
        self.world.qpos[address : address + 3] = place
        self.world.qpos[address + 3 : address + 7] = quaternion

    def close(self, steps: int) -> None:
        self.robot.command_opening(np.zeros(1, np.float32))
        for _ in range(steps):
            self.world.advance()


def test_gels_stand_on_the_pads_faces_when_the_gripper_is_closed(robot: RobotPlacement) -> None:
    assert robot.gripper is not None
    scene = Scene.empty()
    scene.add_robot(robot)
    world = World(scene.compile())
    model, data = world.model, world.data
    assert data is not None
    for name, position in zip(robot.gripper.joints, robot.gripper.joint_closed, strict=True):
        world.qpos[model.joint(robot.gripper_prefix + name).qposadr[0]] = position
    world.refresh()
    tcp = data.site(robot.tcp_site).xmat.reshape(3, 3)
    for sensor, sign in zip(on_pads(robot, DIGIT), (-1.0, 1.0), strict=True):
        finger, pad = data.body(sensor.parent_body), data.geom(sensor.replaced_pad)
        turn, at = np.empty(9), np.array(sensor.sensor_in_parent.translation)
        mujoco.mju_quat2Mat(turn, np.roll(sensor.sensor_in_parent.quaternion, 1))
        rotation = finger.xmat.reshape(3, 3) @ turn.reshape(3, 3)
        tip = finger.xpos + finger.xmat.reshape(3, 3) @ (at + turn.reshape(3, 3) @ np.array(DIGIT.gel_center))
        in_pad = pad.xmat.reshape(3, 3).T @ (tip - pad.xpos)
        out_of_pad = pad.xmat.reshape(3, 3).T @ rotation[:, 0]
        # A pad is a box: the gel's tip lies in the middle of one of its faces, and the gel faces the way that it does.
        face = int(np.abs(out_of_pad).argmax())
        assert abs(out_of_pad[face]) == pytest.approx(1.0, abs=1e-6)
        half = model.geom(sensor.replaced_pad).size[face] * np.sign(out_of_pad[face])
        np.testing.assert_allclose(in_pad, half * np.eye(3)[face], atol=5e-4)
        assert sign * (rotation[:, 0] @ tcp[:, 1]) > 0.9, "the gels face each other"
        assert rotation[:, 2] @ tcp[:, 2] > 0.9, "upright along the fingers"


def test_a_closed_empty_gripper_feels_nothing(robot: RobotPlacement) -> None:
    grasp = Grasp(robot)
    background = grasp.frames()
    grasp.close(60)
    for sensor, before, frame in zip(grasp.sensors, background, grasp.frames(), strict=True):
        assert float(sensor.force) == 0.0
        np.testing.assert_array_equal(frame, before)


def test_both_images_show_what_is_grasped_where_it_touches_and_the_background_elsewhere(robot: RobotPlacement) -> None:
    grasp = Grasp(robot)
    background = grasp.frames()
    grasp.put_between_the_pads()
    grasp.close(75)
    for sensor, before in zip(grasp.sensors, background, strict=True):
        reading = sensor.read()
        force = float(sensor.force)
        assert force > 5.0
        depth = DIGIT.max_indentation * force / DIGIT.force_range[1]
        assert reading["indentation"].max() == pytest.approx(depth, rel=0.1)
        x, y, z = _touched(grasp.data, grasp.world.model, sensor)
        row, column = (float(pixel) for pixel in GEL.pixels(y / x, z / x))
        rows, columns = np.indices(before.shape[:2])
        distance = np.hypot(rows - row, columns - column) * x / FOCAL
        radius = _disc(depth)
        changed = (reading["rgb"] != before).any(axis=2)
        assert changed[distance < 0.5 * radius].mean() > 0.8
        assert not changed[distance > 1.2 * radius + 0.002].any()


def _disc(depth: float) -> float:
    """Return the radius of the disc that a plane leaves, pressed so deep into the dome of a gel [m]."""
    x, y, z = DIGIT.gel_center
    radii = np.linspace(0.0, 0.03, 3001)
    return float(radii[np.searchsorted(x - GEL.surface(y + radii, np.full_like(radii, z)), depth)])


def _touched(data: mujoco.MjData, model: mujoco.MjModel, sensor: SimTactile) -> NDArray[np.float64]:
    """Return the middle of the contacts with a gel, in the frame of the sensor's camera [m]."""
    gel, box = model.geom(sensor.placement.gel_name).id, model.geom("box").id
    points = [contact.pos for contact in data.contact if {contact.geom1, contact.geom2} == {gel, box}]
    body = data.body(sensor.placement.body_name)
    in_sensor = body.xmat.reshape(3, 3).T @ (np.mean(points, axis=0) - body.xpos)
    return in_sensor - np.array(DIGIT.camera_position)


def test_nothing_of_a_finger_stands_in_front_of_its_gel(robot: RobotPlacement) -> None:
    grasp = Grasp(robot)
    model, data = grasp.world.model, grasp.data
    for sensor in grasp.sensors:
        body = model.body(sensor.placement.body_name).id
        turn = data.xmat[body].reshape(3, 3)
        tip = data.xpos[body] + turn @ np.array(DIGIT.gel_center)
        geom = np.empty(1, np.int32)
        distance = mujoco.mj_ray(model, data, tip + 0.002 * turn[:, 0], -turn[:, 0], None, 1, -1, geom, None)
        assert distance == pytest.approx(0.002, abs=1e-6)
        assert model.geom_bodyid[geom[0]] == body


def test_two_pads_on_a_finger_give_way_to_one_gel_and_keep_their_names(tmp_path: Path) -> None:
    text = FRANKA_HAND.mjcf.read_text()
    for side in ("left", "right"):
        whole = f'name="{side}_pad" class="pad" size="0.00875 0.0076 0.00925" pos="0 0.0076 0.04525"'
        assert whole in text
        lower = f'name="{side}_pad" class="pad" size="0.00875 0.0076 0.004" pos="0 0.0076 0.04025"'
        upper = f'<geom name="{side}_tip" class="pad" size="0.00875 0.0076 0.0055" pos="0 0.0076 0.05025"/>'
        text = text.replace(f"<geom {whole}/>", f"<geom {lower}/>{upper}")
    file = tmp_path / "two_pads.xml"
    file.write_text(text)
    hand = replace(FRANKA_HAND, mjcf_file=str(file), pad_geoms=(("left_pad", "left_tip"), ("right_pad", "right_tip")))
    robot = replace(ROBOTS["franka_hand"], gripper=hand)
    grasp = Grasp(robot)
    model = grasp.world.model
    for name in ("left_pad", "left_tip", "right_pad", "right_tip"):
        geom = model.geom(robot.gripper_prefix + name)
        is_gel = geom.bodyid[0] in [model.body(sensor.placement.body_name).id for sensor in grasp.sensors]
        assert is_gel != (geom.contype[0] == 0), "the gel or one that no longer touches"
    background = grasp.frames()
    grasp.put_between_the_pads()
    grasp.close(75)
    assert all((frame != before).any() for frame, before in zip(grasp.frames(), background, strict=True))


def test_a_gripper_whose_fingers_are_the_other_way_round_is_refused() -> None:
    left, right = FRANKA_HAND.pad_geoms
    swapped = replace(FRANKA_HAND, pad_geoms=(right, left))
    with pytest.raises(InvalidSetup, match="y axis of the TCP must point from"):
        on_pads(replace(ROBOTS["franka_hand"], gripper=swapped), DIGIT)


@pytest.mark.parametrize(
    ("robot", "carried"), [(WITH_HAND, "a hand, Tilburg Hand"), (replace(WITH_HAND, hand=None), "nothing")]
)
def test_a_robot_without_a_gripper_has_no_pads(robot: RobotPlacement, carried: str) -> None:
    with pytest.raises(InvalidSetup, match=carried):
        on_pads(robot, DIGIT)
