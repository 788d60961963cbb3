"""The contract of descriptions of arms, as tests: figures, model file and servos fit each other."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.kinematics import kinematics_of
from rcs.robots.description import ArmDescription, GripperDescription, HandDescription, Mount
from rcs.sim.robot_model import MAX_JOINT_SAG, MAX_TCP_SAG
from rcs.sim.scene import RobotPlacement, Scene
from rcs.spatial import Pose

POSES = 20
"""Random poses of the arm that kinematics are compared in."""


class DescriptionContract:
    """Checks the description of an arm, in a scene as tasks have it."""

    arm: ArmDescription
    """The description. To be set."""
    gripper: GripperDescription | None = None
    """A gripper at its flange; None for none."""
    hand: HandDescription | None = None
    """A hand instead of a gripper; None for none."""
    base_in_scene: Mount = Mount()
    """How its lab stands it beside the table: x of the scene points from the robot to the table."""
    hold_tolerance: float = MAX_JOINT_SAG
    """By how much a joint may sag at home [rad]."""
    settle_time: float = 1.0
    """How long the arm may take for a step of 0.1 rad of all joints [s]."""
    settle_tolerance: float = 1e-3
    """By how much a joint may miss its target then [rad]."""

    def published_chain(self) -> tuple[str, Sequence[Pose]] | None:
        """Return published figures to compare the model with; None where there are none.

        Returns:
            A site of the arm, or with the prefix `gripper/` of what it carries, and its chain from the base: the pose
            of each joint in the one before, which it turns about its z axis, and in the end that of the site.
        """
        return None

    @property
    def placement(self) -> RobotPlacement:
        """The arm as it stands in the scene."""
        stand = self.base_in_scene
        return RobotPlacement(name="robot", arm=self.arm, gripper=self.gripper, hand=self.hand, base_in_scene=stand)

    @pytest.fixture(name="model", scope="class")
    @classmethod
    def make_model(cls) -> mujoco.MjModel:
        """Make a scene with the arm alone, which is refused when its file gives the base a pose."""
        scene = Scene.empty()
        scene.add_robot(cls().placement)
        return scene.compile()

    def at(self, model: mujoco.MjModel, joints: Sequence[float] | NDArray[np.float64]) -> mujoco.MjData:
        """Return data with the arm at joints [rad] and commanded to stay, and a gripper open."""
        data = mujoco.MjData(model)
        robot = self.placement
        for joint, servo, q in zip(self.arm.joints, self.arm.actuators, joints, strict=True):
            data.joint(robot.prefix + joint).qpos[0] = data.actuator(robot.prefix + servo).ctrl[0] = q
        if self.gripper is not None:
            for joint, q in zip(self.gripper.joints, self.gripper.joint_open, strict=True):
                data.joint(robot.gripper_prefix + joint).qpos[0] = q
            data.actuator(robot.gripper_prefix + self.gripper.actuator).ctrl[0] = self.gripper.ctrl_open
        mujoco.mj_forward(model, data)
        return data

    def joints_of(self, data: mujoco.MjData) -> NDArray[np.float64]:
        """Return the positions of the arm's joints [rad]."""
        return np.array([data.joint(self.placement.prefix + name).qpos[0] for name in self.arm.joints])

    def some_joints(self) -> Iterator[NDArray[np.float64]]:
        """Give the home pose and random ones within the limits [rad]."""
        yield np.array(self.arm.home)
        yield from np.random.default_rng(1).uniform(self.arm.joint_lower, self.arm.joint_upper, (POSES, self.arm.dof))

    def test_each_servo_drives_the_joint_of_its_place(self, model: mujoco.MjModel) -> None:
        """From base to tip, with positions as targets."""
        prefix = self.placement.prefix
        for joint, servo in zip(self.arm.joints, self.arm.actuators, strict=True):
            actuator = model.actuator(prefix + servo)
            assert int(actuator.trnid[0]) == model.joint(prefix + joint).id
            assert actuator.gainprm[0] == -actuator.biasprm[1] > 0.0, "it is a position servo: target and joint agree"

    def test_limits_in_the_file_are_those_of_the_description(self, model: mujoco.MjModel) -> None:
        """One is what devices check, the other what is simulated."""
        joints = [model.joint(self.placement.prefix + name).id for name in self.arm.joints]
        servos = [model.actuator(self.placement.prefix + name).id for name in self.arm.actuators]
        limits = np.transpose([self.arm.joint_lower, self.arm.joint_upper])
        np.testing.assert_allclose(model.jnt_range[joints], limits, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(model.actuator_ctrlrange[servos], limits, rtol=0.0, atol=1e-9)
        effort = np.outer(self.arm.effort_limit, [-1.0, 1.0])
        np.testing.assert_allclose(model.jnt_actfrcrange[joints], effort, rtol=1e-9)

    def test_simulation_solver_and_published_figures_agree(self, model: mujoco.MjModel) -> None:
        """On where the TCP is; on a site of the published chain where there is one."""
        kinematics = kinematics_of(self.arm, self.gripper or self.hand)
        published = self.published_chain()
        for joints in self.some_joints():
            self._assert_site(model, self.placement.tcp_site, joints, kinematics.forward(joints))
            if published is not None:
                site, (*fixed, last) = published
                turns = [Pose.from_rpy((0.0, 0.0, 0.0), (0.0, 0.0, q)) for q in joints]
                pose = math.prod((frame * turn for frame, turn in zip(fixed, turns, strict=True)), start=Pose())
                self._assert_site(model, self.placement.prefix + site, joints, pose * last)

    def _assert_site(self, model: mujoco.MjModel, site: str, joints: NDArray[np.float64], pose: Pose) -> None:
        pose = self.base_in_scene.pose * pose
        found = self.at(model, joints).site(site)
        np.testing.assert_allclose(found.xpos, pose.translation, rtol=0.0, atol=1e-8)
        np.testing.assert_allclose(found.xmat.reshape(3, 3), pose.matrix[:3, :3], rtol=0.0, atol=1e-8)

    def test_at_home_the_arm_reaches_forward_and_nothing_touches(self, model: mujoco.MjModel) -> None:
        """Links that overlap would push each other away, and an arm that faces away finds no table."""
        data = self.at(model, self.arm.home)
        ahead = data.site(self.placement.tcp_site).xpos - self.base_in_scene.translation
        assert ahead[0] > 0.0, (
            f"at home, the TCP is behind the base, at {ahead} m: the arm faces away from the table. Set base_in_scene "
            "to how its lab stands it, or put its base body into an outer one without a pose and name that as base_body"
        )
        assert data.ncon == 0

    def test_the_servos_hold_the_home_pose(self, model: mujoco.MjModel) -> None:
        """For a second; if they do not, bodies lack gravcomp="1", or the servos are too weak."""
        data = self.at(model, self.arm.home)
        before = data.site(self.placement.tcp_site).xpos.copy()
        mujoco.mj_step(model, data, nstep=round(1.0 / model.opt.timestep))
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(self.joints_of(data), self.arm.home, rtol=0.0, atol=self.hold_tolerance)
        np.testing.assert_allclose(data.site(self.placement.tcp_site).xpos, before, rtol=0.0, atol=MAX_TCP_SAG)

    def test_no_command_asks_more_of_a_joint_than_its_limit(self, model: mujoco.MjModel) -> None:
        """Not even the farthest."""
        data = self.at(model, self.arm.home)
        dofs = [int(model.joint(self.placement.prefix + name).dofadr[0]) for name in self.arm.joints]
        for servo, upper in zip(self.arm.actuators, self.arm.joint_upper, strict=True):
            data.actuator(self.placement.prefix + servo).ctrl[0] = upper
        for _ in range(100):
            mujoco.mj_step(model, data)
            assert np.all(np.abs(data.qfrc_actuator[dofs]) <= np.array(self.arm.effort_limit) + 1e-9)

    def test_a_step_of_a_tenth_of_a_radian_settles(self, model: mujoco.MjModel) -> None:
        """All joints at once, each towards the middle of its range."""
        data = self.at(model, self.arm.home)
        middle = np.mean([self.arm.joint_lower, self.arm.joint_upper], axis=0)
        target = np.array(self.arm.home) + np.where(middle < self.arm.home, -0.1, 0.1)
        for servo, q in zip(self.arm.actuators, target, strict=True):
            data.actuator(self.placement.prefix + servo).ctrl[0] = q
        mujoco.mj_step(model, data, nstep=round(self.settle_time / model.opt.timestep))
        np.testing.assert_allclose(self.joints_of(data), target, rtol=0.0, atol=self.settle_tolerance)
