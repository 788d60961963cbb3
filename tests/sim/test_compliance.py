"""Arms that give way: a push moves them by force over stiffness, and nothing else about their motion changes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs._core import StepEnd
from rcs.kinematics import kinematics_of
from rcs.robots import FR3, FRANKA_HAND, ROBOTIQ_2F85, SO101, SO101_GRIPPER, UR5E, XARM7, Compliance
from rcs.sim import RobotPlacement, Scene, World
from rcs.sim.robot import SimRobot
from rcs.spatial import Pose

ROBOTS = {
    "fr3": RobotPlacement(name="robot", arm=FR3, gripper=FRANKA_HAND),
    "ur5e": RobotPlacement(name="robot", arm=UR5E, gripper=ROBOTIQ_2F85),
    "xarm7": RobotPlacement(name="robot", arm=XARM7, gripper=FRANKA_HAND),
    "so101": RobotPlacement(name="robot", arm=SO101, gripper=SO101_GRIPPER),
}
SMALL = {"so101": 0.1}
"""Share of the usual stiffness for small motors."""
LAW = 0.02
"""How far a deflection may be from force over stiffness."""


def springs(name: str, kind: str) -> Compliance:
    share = SMALL.get(name, 1.0)
    return Compliance(joints=200.0 * share) if kind == "joints" else Compliance(tcp=(1000.0 * share, 60.0 * share))


class Pushed:
    """A robot at home, without contacts, and a push on its TCP."""

    def __init__(self, name: str, compliance: Compliance | None, **options: Any) -> None:
        placement = replace(ROBOTS[name], compliance=compliance)
        scene = Scene.empty()
        scene.add_robot(placement)
        model = scene.compile()
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.world = World(model, frequency=50.0, **options)
        self.robot = SimRobot(self.world, placement)
        if options.get("stepping") == "sync":
            self.robot.wait_for_arrival()
        self.robot.go_home()
        self.world.refresh()
        self.home = np.array(placement.arm.home)
        self.kinematics = kinematics_of(placement.arm, placement.gripper)

    def settle(self, wrench: NDArray[np.float64], seconds: float = 4.0) -> None:
        """Push the TCP with a force and a moment in the frame of the base, for a while."""
        data, model = self.world.data, self.world.model
        site = self.robot.layout.tcp_site
        body = model.site_bodyid[site]
        for _ in range(round(50 * seconds)):
            lever = data.site_xpos[site] - data.xipos[body]
            data.xfrc_applied[body] = [*wrench[:3], *(wrench[3:] + np.cross(lever, wrench[:3]))]
            self.world.advance()

    def deflection(self) -> NDArray[np.float64]:
        """How far the TCP is from where it is led [m, rad], (6,)."""
        led, here = self.kinematics.forward(self.home), Pose.from_tquat(self.robot.tcp_tquat)
        turn = Pose(np.zeros(3), here.quaternion) * Pose(np.zeros(3), led.quaternion).inverse()
        return np.concatenate([np.array(here.translation) - led.translation, turn.rotvec])


@pytest.mark.parametrize("name", ROBOTS)
def test_a_torque_moves_each_joint_by_torque_over_stiffness(name: str) -> None:
    soft = springs(name, "joints")
    for seed in range(3):
        pushed = Pushed(name, soft)
        draws = np.random.default_rng(seed)
        torque = draws.choice([-1, 1], pushed.home.size) * draws.uniform(0.2, 1.0, pushed.home.size)
        torque *= 4.0 * SMALL.get(name, 1.0)
        pushed.world.data.qfrc_applied[pushed.robot.layout.qvel] = torque
        for _ in range(200):
            pushed.world.advance()
        np.testing.assert_allclose(pushed.robot.joints - pushed.home, torque / np.array(soft.joints), rtol=LAW)
        assert np.abs(pushed.robot.joint_velocities).max() < 1e-4


@pytest.mark.parametrize("name", ROBOTS)
def test_a_force_on_the_tcp_moves_joints_by_its_torques_over_stiffness(name: str) -> None:
    soft = springs(name, "joints")
    for force in np.array([[1, 0, 0], [0, 1, 0], [0, 0, -1], [-0.6, 0.5, 0.6]]):
        pushed = Pushed(name, soft)
        wrench = np.concatenate([8.0 * SMALL.get(name, 1.0) * force, np.zeros(3)])
        pushed.settle(wrench)
        torque = pushed.kinematics.jacobian(pushed.robot.joints).T @ wrench
        off = pushed.robot.joints - pushed.home - torque / np.array(soft.joints)
        assert np.linalg.norm(off) < LAW * np.linalg.norm(torque / np.array(soft.joints))


DIRECTIONS = np.array([*np.eye(6), *-np.eye(6)[:3], [0.6, -0.6, 0.5, 0, 0, 0]])


@pytest.mark.parametrize("name", ["fr3", "ur5e", "xarm7"])
def test_a_push_on_the_tcp_moves_it_by_force_over_stiffness_and_no_other_way(name: str) -> None:
    soft = springs(name, "tcp")
    assert soft.tcp is not None
    stiffness, most = np.array(soft.tcp), np.array([10.0] * 3 + [3.0] * 3)
    for direction in DIRECTIONS:
        pushed = Pushed(name, soft)
        pushed.settle(most * direction)
        expected = most * direction / stiffness
        off = pushed.deflection() - expected
        assert np.abs(off[:3]).max() < LAW * np.linalg.norm(expected[:3]) + 1e-5
        assert np.abs(off[3:]).max() < LAW * np.linalg.norm(expected[3:]) + 1e-4


def test_a_push_moves_the_tcp_of_an_arm_of_five_joints_where_it_can_move() -> None:
    soft = springs("so101", "tcp")
    assert soft.tcp is not None
    draws = np.random.default_rng(0)
    for _ in range(6):
        pushed = Pushed("so101", soft)
        to = pushed.home + draws.uniform(-0.05, 0.05, 5)
        led, there = pushed.kinematics.forward(pushed.home), pushed.kinematics.forward(to)
        turn = Pose(np.zeros(3), there.quaternion) * Pose(np.zeros(3), led.quaternion).inverse()
        way = np.concatenate([np.array(there.translation) - led.translation, turn.rotvec])
        pushed.settle(np.array(soft.tcp) * way, 12.0)
        off = pushed.deflection() - way
        assert np.linalg.norm(off[:3]) < LAW * np.linalg.norm(way[:3])
        assert np.linalg.norm(off[3:]) < LAW * np.linalg.norm(way[3:])


@pytest.mark.parametrize("kind", ["joints", "tcp"])
@pytest.mark.parametrize("name", ROBOTS)
def test_nothing_drifts_without_a_push_and_what_was_pushed_comes_back(name: str, kind: str) -> None:
    pushed = Pushed(name, springs(name, kind))
    pushed.settle(np.zeros(6), 5.0)
    np.testing.assert_allclose(pushed.robot.joints, pushed.home, atol=1e-6)
    pushed.settle(np.array([5.0, 5.0, -5.0, 0, 0, 0]) * SMALL.get(name, 1.0), 1.0)
    assert np.abs(pushed.robot.joints - pushed.home).max() > 5e-3
    pushed.settle(np.zeros(6), 12.0)
    np.testing.assert_allclose(pushed.deflection(), 0.0, atol=1e-3)


@pytest.mark.parametrize("kind", ["joints", "tcp"])
@pytest.mark.parametrize("name", ROBOTS)
def test_free_motion_is_that_of_stiff_servos(name: str, kind: str) -> None:
    """It is apart by no more than 8 ms of the way, at the 1.25 rad/s of these targets."""
    stiff, soft = Pushed(name, None), Pushed(name, springs(name, kind))
    apart = []
    for k in range(150):
        target = stiff.home + 0.3 * np.sin(k / 12) * np.where(np.arange(stiff.home.size) % 2, 1, -1)
        for one in (stiff, soft):
            one.robot.command_joints(target)
            one.world.advance()
        apart.append(np.abs(stiff.robot.joints - soft.robot.joints).max())
    assert max(apart) < 10e-3


@pytest.mark.parametrize("kind", ["joints", "tcp"])
def test_one_copy_is_each_of_many(kind: str) -> None:
    one, many = Pushed("fr3", springs("fr3", kind)), Pushed("fr3", springs("fr3", kind), copies=3, threads=2)
    applied = many.world.core.component(mujoco.mjtState.mjSTATE_XFRC_APPLIED.value)
    body = int(one.world.model.site_bodyid[one.robot.layout.tcp_site])
    applied.reshape(3, -1, 6)[:, body, :3] = one.world.data.xfrc_applied[body, :3] = [4.0, -8.0, 3.0]
    for k in range(60):
        target = one.home + 0.2 * np.sin(k / 9)
        for pushed in (one, many):
            pushed.robot.command_joints(target)
            pushed.world.advance()
    for joints in many.robot.joints:
        np.testing.assert_array_equal(joints, one.robot.joints)


@pytest.mark.parametrize("kind", ["joints", "tcp"])
def test_a_saved_state_goes_on_with_the_same_bits(kind: str) -> None:
    pushed, other = (Pushed("xarm7", springs("xarm7", kind)) for _ in range(2))

    def go(one: Pushed, steps: range) -> NDArray[np.float64]:
        for k in steps:
            one.robot.command_joints(one.home + 0.3 * np.sin(k / 7))
            one.world.advance()
        return one.world.states()

    pushed.settle(np.array([3.0, 9.0, 4.0, 0, 0, 0]), 0.3)
    go(pushed, range(13))
    saved = pushed.world.save()
    expected = go(pushed, range(13, 40))
    go(other, range(5))
    other.world.load(saved)
    np.testing.assert_array_equal(go(other, range(13, 40)), expected)


@pytest.mark.parametrize("kind", ["joints", "tcp"])
def test_a_synchronous_step_ends_although_the_arm_is_pushed_away(kind: str) -> None:
    pushed = Pushed("fr3", springs("fr3", kind), stepping="sync")
    body = int(pushed.world.model.site_bodyid[pushed.robot.layout.tcp_site])
    pushed.world.data.xfrc_applied[body, :3] = [0.0, 10.0, -10.0]
    arm = pushed.robot.arm()
    arm.open()
    target = pushed.home + 0.3
    arm.command_joints(target)
    assert not arm.has_arrived()
    pushed.world.advance()
    assert pushed.world.ends == [StepEnd.converged]
    assert arm.has_arrived()
    apart = np.abs(pushed.robot.joints - target).max()
    assert 5e-3 < apart < 0.3
    arm.close()


@pytest.mark.parametrize("kind", ["joints", "tcp"])
def test_an_arm_that_holds_is_pushed_no_farther(kind: str) -> None:
    pushed, wrench = Pushed("fr3", springs("fr3", kind)), np.array([0.0, 10.0, -20.0, 0.0, 0.0, 0.0])
    pushed.settle(wrench)
    before = pushed.robot.joints
    assert np.abs(before - pushed.home).max() > 0.03
    for _ in range(50):
        pushed.robot.stop()
        pushed.settle(wrench, 0.02)
    np.testing.assert_allclose(pushed.robot.joints, before, atol=1e-4)


@pytest.mark.parametrize("kind", ["joints", "tcp"])
def test_a_load_that_the_controller_knows_of_moves_nothing(kind: str) -> None:
    pushed, center = Pushed("fr3", springs("fr3", kind)), np.array([0.0, 0.0, 0.1034])  # the TCP
    weight = np.array([0.0, 0.0, -9.81, 0.0, 0.0, 0.0])
    pushed.settle(weight)
    assert np.linalg.norm(pushed.deflection()[:3]) > 9e-3
    pushed.robot.set_load(1.0, center)
    pushed.settle(weight)
    assert np.linalg.norm(pushed.deflection()[:3]) < 5e-4


def test_no_motor_exerts_more_than_it_can() -> None:
    pushed = Pushed("so101", Compliance(tcp=(5000.0, 50.0)))
    limit = pushed.world.model.jnt_actfrcrange[pushed.robot.layout.joint_ids, 1]
    for _ in range(25):
        pushed.settle(np.array([0.0, 0.0, -40.0, 0.0, 0.0, 0.0]), 0.02)
        torques = np.abs(pushed.world.data.qfrc_actuator[pushed.robot.layout.qvel])
        assert np.all(torques <= limit + 1e-9)
    assert np.any(torques > 0.99 * limit)
