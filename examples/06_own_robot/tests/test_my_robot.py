"""Our arm keeps the contracts of rcs, its two models are the same arm, and the scripted expert can use it."""

from __future__ import annotations

from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest
from my_robot.description import MY_ROBOT
from my_robot.driver import MyDriver
from my_robot.from_urdf import MY_ROBOT_URDF
from numpy.typing import NDArray

import rcs
from rcs.agents import agent_for
from rcs.devices import Arm
from rcs.kinematics import kinematics_of, load
from rcs.robots import FRANKA_HAND
from rcs.testing import ArmContract, DescriptionContract, EnvContract

ROBOTS = ("my_robot", "my_robot_urdf")


class TestTheDescription(DescriptionContract):
    """Limits, kinematics and servos of the description and of its MJCF, with the hand that its lab gives it."""

    arm = MY_ROBOT
    gripper = FRANKA_HAND


class TestTheDescriptionFromTheUrdf(TestTheDescription):
    """The same, from the other file."""

    arm = MY_ROBOT_URDF


class TestTheArm(ArmContract):
    """The simulated arm behind the interface that the real one will have."""

    robot = "my_robot"

    def make_device(self) -> Arm:
        """Return the arm of a new world whose time passes in steps of 10 ms."""
        env = rcs.make("Free", robot=self.robot, frequency=100.0)
        env.reset(seed=0)
        self.world = env.simulation.world
        return env.simulation.robots[0].arm()

    def advance(self, seconds: float) -> None:
        """Let simulated time pass."""
        for _ in range(round(100.0 * seconds)):
            self.world.advance()


class TestTheArmFromItsUrdf(TestTheArm):
    """The same, from the other file."""

    robot = "my_robot_urdf"


class TestTheEnvironment(EnvContract):
    """An environment of our arm."""

    longest_episode = 6

    def make_env(self) -> Any:
        """Return an environment with short episodes."""
        return rcs.make("PickCuboid", robot="my_robot", max_episode_steps=6)


def test_urdf_and_mjcf_are_the_same_arm() -> None:
    """Poses, inertia, limits and controllers agree, so that either can be used."""
    one, other = load(MY_ROBOT).compile(), load(MY_ROBOT_URDF).compile()
    for field in ("jnt_range", "jnt_actfrcrange", "dof_armature", "actuator_gainprm", "actuator_biasprm"):
        np.testing.assert_allclose(getattr(one, field), getattr(other, field), rtol=1e-9, err_msg=field)
    kinematics = kinematics_of(MY_ROBOT), kinematics_of(MY_ROBOT_URDF)
    for joints in np.random.default_rng(0).uniform(MY_ROBOT.joint_lower, MY_ROBOT.joint_upper, (20, MY_ROBOT.dof)):
        a, b = (solver.forward(joints).matrix for solver in kinematics)
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(joint_inertia(one, joints), joint_inertia(other, joints), rtol=0.0, atol=1e-9)


def joint_inertia(model: mujoco.MjModel, joints: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inertia matrix of the joints [kg m^2], in which every mass and inertia has its part."""
    data = mujoco.MjData(model)
    data.qpos[:] = joints
    mujoco.mj_forward(model, data)
    matrix = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, matrix)
    return matrix


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_scripted_expert_picks_the_cuboid(robot: str) -> None:
    """Everywhere in the area of the lab: at least nine times of ten."""
    setup = rcs.Setup(task="PickCuboid", robot=robot)
    env = rcs.make(setup)
    expert = agent_for(env)
    assert sum(rcs.run_episode(env, expert, seed=seed).success is True for seed in range(10)) >= 9
    env.close()


def test_the_expert_of_our_task_pushes_the_block() -> None:
    """From everywhere where it may lie."""
    env = rcs.make("PushToLine", robot="my_robot")
    expert = agent_for(env)
    assert all(rcs.run_episode(env, expert, seed=seed).success for seed in range(10))
    env.close()


class TestOurTask(EnvContract):
    """One copy and many have the same bits, among others."""

    longest_episode = 6

    def make_env(self) -> Any:
        """Return an environment with short episodes."""
        return rcs.make("PushToLine", robot="my_robot", layers=["HalfSpeed"], max_episode_steps=6)


class TestTheArmOfOurDriver(ArmContract):
    """The arm that our driver makes from an address."""

    distance = 1.2  # it moves in real time, and a busy machine looks late

    def make_device(self) -> Arm:
        """Return the arm."""
        return MyDriver().arm("192.0.2.7", MY_ROBOT, {})


@pytest.mark.parametrize("robot", ROBOTS)
def test_many_copies_step_together(robot: str) -> None:
    """On native threads."""
    envs = rcs.make_vec("PickCuboid", robot=robot, copies=3)
    observations, _ = envs.reset(seed=0)
    envs.step(envs.action_space.sample())
    assert observations["joints"].shape == (3, 6)
    envs.close()


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_cameras_of_the_lab_are_mounted(robot: str) -> None:
    """Those of `rcs collect` by default."""
    env = rcs.make("Free", robot=robot, cameras=("wrist", "side"))
    space: Any = env.observation_space
    assert set(space["frames"]) == {"wrist", "side"}
    env.close()


def test_gymnasium_makes_it_by_its_id() -> None:
    """Importing `rcs.installed` registers the ids of all packages."""
    env = gymnasium.make("rcs.installed:rcs/PickCuboid-MyRobot-v0")
    observation, _ = env.reset(seed=0)
    assert observation["joints"].shape == (6,)
    env.close()
