"""A simulated arm and gripper keep the same contracts as real ones."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
import pytest

from rcs._core import ArmLimits, GripperMap, Motion, MotionLimits, SimArm, SimGripper
from rcs.devices import Arm, Gripper
from rcs.errors import InvalidSetup
from rcs.kinematics import kinematics_of
from rcs.robots.fr3 import FR3
from rcs.sim import RobotPlacement, Scene, World
from rcs.sim.robot import SimRobot
from rcs.testing import ArmContract, GripperContract


def at_home(lab: mujoco.MjModel, placement: RobotPlacement, copies: int | None = None) -> SimRobot:
    # Time passes in steps of 10 ms, so that contracts can look at motions.
    robot = SimRobot(World(lab, frequency=100.0, copies=copies, threads=1), placement)
    robot.go_home()
    robot.world.refresh()
    return robot


class InTheLab:
    copies: int | None = None

    @pytest.fixture(autouse=True)
    def _in_the_lab(self, lab: mujoco.MjModel, placement: RobotPlacement) -> Iterator[None]:
        self.lab, self.placement = lab, placement
        yield
        self.__dict__.clear()  # pytest keeps test objects to the end, and with them the world

    def advance(self, seconds: float) -> None:
        for _ in range(round(100 * seconds)):
            self.robot.world.advance()


class TestSimArm(InTheLab, ArmContract):
    def make_device(self) -> Arm:
        self.robot = at_home(self.lab, self.placement, self.copies)
        return self.robot.arm(self.robot.world.copies - 1)


class TestSimArmOfABatch(TestSimArm):
    copies = 2


class TestSimGripper(InTheLab, GripperContract):
    def make_device(self) -> Gripper:
        self.robot = at_home(self.lab, self.placement, self.copies)
        return self.robot.gripper_device(self.robot.world.copies - 1)


class TestSimGripperOfABatch(TestSimGripper):
    copies = 2


def test_an_arm_of_one_copy_leaves_the_others_alone(lab: mujoco.MjModel, placement: RobotPlacement) -> None:
    robot = at_home(lab, placement, copies=3)
    arm = robot.arm(1)
    arm.open()
    arm.command_joints(robot.joints[1] + 0.1)
    for _ in range(10):
        robot.world.advance()
    np.testing.assert_array_equal(robot.joints[0], robot.joints[2])
    assert np.abs(robot.joints[1] - robot.joints[0]).max() > 0.05


def test_a_gripper_that_holds_an_object_goes_on_pressing_when_it_is_told_to_hold(placement: RobotPlacement) -> None:
    scene = Scene.empty()
    scene.add_robot(placement)
    # A block that stands between the fingers, which open along the base's y axis.
    tcp = kinematics_of(placement.arm, placement.gripper).forward(np.array(placement.arm.home)).translation
    scene.spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.01, 0.02, 0.01], pos=list(tcp))
    model = scene.compile()
    robot = at_home(model, placement)
    gripper = robot.gripper_device()
    gripper.open()
    gripper.command_opening(0.0)
    assert not gripper.has_arrived()
    for _ in range(100):
        robot.world.advance()
    assert gripper.has_arrived()
    assert gripper.state().opening == pytest.approx(0.5, abs=0.05)
    data = robot.world.data
    assert data is not None
    force = data.actuator_force.copy()
    gripper.hold()
    for _ in range(20):
        robot.world.advance()
    np.testing.assert_allclose(data.actuator_force[-1], force[-1], rtol=0.05)


def test_an_opening_is_the_share_of_the_full_width(lab: mujoco.MjModel, placement: RobotPlacement) -> None:
    robot = at_home(lab, placement)
    gripper = robot.gripper_device()
    gripper.open()
    assert gripper.state().opening == pytest.approx(1.0)
    robot.world.qpos[robot.layout.finger_qpos] = 0.01
    assert gripper.state().opening == pytest.approx(0.25)


def test_ids_that_are_not_in_the_world_are_refused(robot: SimRobot) -> None:
    ids, core = robot.layout, robot.world.core
    limits = ArmLimits(list(FR3.joint_lower), list(FR3.joint_upper), list(FR3.velocity_limit))
    rates = [[1.0] * 7] * 3
    bounds = MotionLimits(list(FR3.joint_lower), list(FR3.joint_upper), *rates)
    motion = Motion(ids.joint_ids, ids.actuator_ids, ids.motion, bounds, 1)
    no_joint = Motion([99, *ids.joint_ids[1:]], ids.actuator_ids, ids.motion, bounds, 1)
    no_servo = Motion(ids.joint_ids, [99, *ids.actuator_ids[1:]], ids.motion, bounds, 1)
    elsewhere = Motion(ids.joint_ids, ids.actuator_ids, ids.motion + 1, bounds, 1)
    short = ArmLimits([-1.0], [1.0], [1.0])
    for arguments in (
        (limits, core, 1, motion),
        (limits, core, 0, no_joint),
        (limits, core, 0, no_servo),
        (limits, core, 0, elsewhere),
        (short, core, 0, motion),
    ):
        with pytest.raises(InvalidSetup):
            SimArm("arm", *arguments)
    fingers, actuator = ids.finger_joint_ids, ids.finger_actuator_ids[0]
    for joints, number, mapping in (
        ([], actuator, GripperMap(0.0, 0.04, 0.0, 1.0)),
        (fingers, 99, GripperMap(0.0, 0.04, 0.0, 1.0)),
        (fingers, actuator, GripperMap(0.04, 0.04, 0.0, 1.0)),
        (fingers, actuator, GripperMap(0.0, 0.04, 1.0, 1.0)),
    ):
        with pytest.raises(InvalidSetup):
            SimGripper("gripper", 0.08, 70.0, core, 0, joints, number, mapping)


def test_a_robot_without_a_gripper_has_no_opening() -> None:
    bare = RobotPlacement(name="fr3", arm=FR3)
    scene = Scene.empty()
    scene.add_robot(bare)
    robot = SimRobot(World(scene.compile()), bare)
    robot.go_home()
    robot.world.advance()
    for use in (lambda: robot.gripper, lambda: robot.opening, robot.gripper_device):
        with pytest.raises(InvalidSetup, match="no gripper"):
            use()
    np.testing.assert_allclose(robot.joints, FR3.home, atol=1e-3)


def test_a_robot_that_is_not_in_the_model_is_refused(cart: mujoco.MjModel, placement: RobotPlacement) -> None:
    with pytest.raises(InvalidSetup, match="not in this model"):
        SimRobot(World(cart), placement)
