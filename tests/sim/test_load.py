"""A load that the controller knows of: arms hold their rated payload with it, and do not fall without it."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from rcs.errors import InvalidSetup
from rcs.robots import FR3, FRANKA_HAND, ROBOTIQ_2F85, UR5E, XARM7
from rcs.robots.description import ArmDescription, GripperDescription
from rcs.sim import RobotPlacement, Scene, World
from rcs.sim.robot import SimRobot

ARMS = [(FR3, FRANKA_HAND), (UR5E, ROBOTIQ_2F85), (XARM7, FRANKA_HAND)]
POSES = 12
NEAR_HOME = 0.4
"""Largest distance of the poses from home in each joint [rad]."""
CENTER = np.array([0.01, -0.02, 0.15])
"""Centre of the load in the flange's frame, about where a gripper holds it [m]."""
GRAVITY = 9.81

# The check of scenes rightly says that a robot sags that carries a weight which nobody told it of.
pytestmark = pytest.mark.filterwarnings("ignore:Robot 'robot' sags")


def load_of(arm: ArmDescription, gripper: GripperDescription) -> float:
    """Return what remains of the rated payload beside the gripper [kg]."""
    assert arm.payload is not None
    return arm.payload - float(mujoco.MjModel.from_xml_path(str(gripper.mjcf)).body_mass.sum())


def loaded(arm: ArmDescription, gripper: GripperDescription, copies: int | None = None) -> SimRobot:
    """Return a robot with a load fixed to its flange, at home."""
    placement = RobotPlacement(name="robot", arm=arm, gripper=gripper)
    scene = Scene.empty()
    scene.add_robot(placement)
    flange = scene.spec.site(placement.prefix + arm.flange_site)
    frame = flange.parent.add_frame(pos=flange.pos, quat=flange.quat)
    weight = flange.parent.add_body(
        name="weight", mass=load_of(arm, gripper), ipos=CENTER, inertia=[0.003] * 3, explicitinertial=True
    )
    weight.set_frame(frame)
    model = scene.compile()
    # Only how it is held counts here, not what it may touch near home.
    model.geom_contype[:] = 0
    robot = SimRobot(World(model, frequency=50.0, copies=copies), placement)
    robot.go_home()
    return robot


def poses(arm: ArmDescription) -> NDArray[np.float64]:
    near = np.array(arm.home) + np.random.default_rng(5).uniform(-NEAR_HOME, NEAR_HOME, (POSES, arm.dof))
    return np.clip(near, arm.joint_lower, arm.joint_upper)


def sags(robot: SimRobot, joints: NDArray[np.float64]) -> NDArray[np.float64]:
    """Hold a pose in each copy for two seconds, and return how far the TCPs gave way [m]."""
    robot.put(joints)
    robot.world.refresh()
    before = robot.tcp_tquat[..., :3]
    for _ in range(100):
        robot.world.advance()
    return np.linalg.norm(robot.tcp_tquat[..., :3] - before, axis=-1)


@pytest.mark.parametrize(("arm", "gripper"), ARMS, ids=lambda about: about.name)
def test_an_arm_holds_its_rated_payload_and_sags_only_if_it_is_not_told_of_it(
    arm: ArmDescription, gripper: GripperDescription
) -> None:
    robot = loaded(arm, gripper, copies=POSES)
    untold = sags(robot, poses(arm))
    robot.set_load(load_of(arm, gripper), CENTER)
    told = sags(robot, poses(arm))
    assert told.max() < 1e-3
    assert told.max() < untold.max() < 0.05


@pytest.mark.parametrize(("arm", "gripper"), ARMS, ids=lambda about: about.name)
def test_no_pose_asks_more_of_a_joint_for_the_rated_payload_than_its_effort_limit(
    arm: ArmDescription, gripper: GripperDescription
) -> None:
    del gripper
    model = mujoco.MjModel.from_xml_path(str(arm.mjcf))
    data = mujoco.MjData(model)
    jacobian = np.empty((3, model.nv))
    flange = model.site(arm.flange_site)
    worst = np.zeros(arm.dof)
    for joints in np.random.default_rng(6).uniform(arm.joint_lower, arm.joint_upper, (5000, arm.dof)):
        data.qpos[:] = joints
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_rne(model, data, 0, data.qfrc_bias)
        mujoco.mj_jacSite(model, data, jacobian, None, flange.id)
        worst = np.maximum(worst, np.abs(data.qfrc_bias + GRAVITY * (arm.payload or 0.0) * jacobian[2]))
    assert np.all(worst < arm.effort_limit)


def test_copies_have_loads_of_their_own_like_worlds_of_one() -> None:
    masses = np.array([0.0, 1.0, 2.0])
    many = loaded(FR3, FRANKA_HAND, copies=3)
    many.set_load(masses, CENTER)
    together = sags(many, np.broadcast_to(FR3.home, (3, 7)))
    for mass, sag in zip(masses, together, strict=True):
        one = loaded(FR3, FRANKA_HAND)
        one.set_load(mass, CENTER)
        assert sags(one, np.array(FR3.home)) == sag
    assert len(set(together)) == 3


def test_the_motors_carry_the_load_and_a_load_of_nothing_changes_nothing() -> None:
    robot = loaded(FR3, FRANKA_HAND)
    data = robot.world.data
    assert data is not None
    dofs = robot.layout.qvel
    robot.set_load(0.0, CENTER)
    mujoco.mj_forward(robot.world.model, data)
    without = data.qfrc_gravcomp[dofs].copy()
    robot.set_load(2.0, CENTER)
    mujoco.mj_forward(robot.world.model, data)
    jacobian = np.empty((3, robot.world.model.nv))
    flange = data.site("robot/flange")
    point = flange.xpos + flange.xmat.reshape(3, 3) @ CENTER
    mujoco.mj_jac(robot.world.model, data, jacobian, None, point, int(robot.world.model.site("robot/flange").bodyid[0]))
    np.testing.assert_allclose(data.qfrc_gravcomp[dofs] - without, 2.0 * GRAVITY * jacobian[2, dofs], atol=1e-6)
    assert np.all(np.abs(data.qfrc_actuator[dofs]) <= np.array(FR3.effort_limit))


@pytest.mark.parametrize(
    ("mass", "center"),
    [
        (-1.0, CENTER),
        (np.nan, CENTER),
        (1.0, [0.0, np.inf, 0.0]),
        ("x", CENTER),
        (None, CENTER),
        ([1.0, 2.0], CENTER),
        (1.0, "abc"),
        (1.0, [0.0, 0.0]),
        (1.0, 0.1),
        (1.0, [[0.0], 0.0, 0.0]),
    ],
)
@pytest.mark.parametrize("copies", [None, 3])
def test_a_load_that_cannot_be_is_refused(mass: Any, center: Any, copies: int | None) -> None:
    robot = loaded(FR3, FRANKA_HAND, copies=copies)
    with pytest.raises(InvalidSetup, match="load of robot 'robot'"):
        robot.set_load(mass, center)
