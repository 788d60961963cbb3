from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs.layers import CartesianControl, XyzrpyControl
from rcs.envs.layers.cartesian import ROWS_PER_THREAD
from rcs.envs.spaces import JOINTS, TQUAT, XYZRPY, joints_space
from rcs.errors import InvalidAction
from rcs.kinematics import IkStatus, kinematics_of
from rcs.robots.fr3 import FR3
from rcs.robots.franka_hand import FRANKA_HAND
from rcs.spatial import distance, tquat_to_xyzrpy

HOME = np.array(FR3.home)
OPEN = np.ones(1, np.float32)


@pytest.fixture
def layer() -> CartesianControl:
    layer = CartesianControl(kinematics_of(FR3, FRANKA_HAND))
    layer.reset({JOINTS: HOME})
    return layer


def layer_of(robot: str, frequency: float = 30.0) -> tuple[CartesianControl, np.ndarray, Callable[[], np.ndarray]]:
    """Return a layer as a setup makes it, the TCP pose of home, and what gives that of the last target."""
    env = rcs.make("Free", robot=robot, control="tquat", relative=False, frequency=frequency)
    placement = env.robots[robot]
    kinematics = kinematics_of(placement.arm, placement.end_effector)
    layer = next(layer for layer in env.stack.layers if isinstance(layer, CartesianControl))
    joints = np.array(placement.arm.home)
    layer.reset({JOINTS: joints})
    last = {JOINTS: joints}
    inner = layer.map_executed

    def execute(executed: Any) -> Any:
        last[JOINTS] = executed[JOINTS]
        return inner(executed)

    layer.map_executed = execute
    return layer, kinematics.forward(joints).tquat, lambda: kinematics.forward(last[JOINTS]).tquat


@pytest.fixture
def home() -> np.ndarray:
    return kinematics_of(FR3, FRANKA_HAND).forward(HOME).tquat


def test_a_pose_near_by_is_reached(layer: CartesianControl, home: np.ndarray) -> None:
    target = home + np.array([0.02, -0.03, 0.04, 0, 0, 0, 0])
    joints = layer.map_action({TQUAT: target, "gripper": OPEN})[JOINTS]
    reached = kinematics_of(FR3, FRANKA_HAND).forward(joints).tquat
    assert distance(reached, target)[0] < 1e-4
    assert distance(reached, target)[1] < 1e-4
    layer.map_executed({JOINTS: joints, "gripper": OPEN})
    assert layer.info()["ik_status"] == IkStatus.ok.value


def test_a_pose_out_of_reach_moves_the_tcp_to_the_nearest_and_the_level_above_learns_where_it_is(
    layer: CartesianControl, home: np.ndarray
) -> None:
    far = home.copy()
    far[0] = 1.9
    joints = layer.map_action({TQUAT: far, "gripper": OPEN})[JOINTS]
    executed = layer.map_executed({JOINTS: joints, "gripper": OPEN})
    assert layer.info()["ik_status"] == IkStatus.nearest.value
    np.testing.assert_array_equal(executed[TQUAT], kinematics_of(FR3, FRANKA_HAND).forward(joints).tquat)
    assert executed[TQUAT][0] > home[0] + 0.2
    assert distance(executed[TQUAT], home)[1] < 0.1, "what nobody asked for is kept"


def test_a_pose_that_is_mapped_and_not_executed_leaves_no_trace(layer: CartesianControl, home: np.ndarray) -> None:
    target = home + np.array([0.02, -0.03, 0.04, 0, 0, 0, 0])
    expected = layer.map_action({TQUAT: target, "gripper": OPEN})[JOINTS]
    for shift in (0.05, 0.1, 0.15):
        layer.map_action({TQUAT: home + np.array([shift, 0, 0, 0, 0, 0, 0]), "gripper": OPEN})
    np.testing.assert_array_equal(layer.map_action({TQUAT: target, "gripper": OPEN})[JOINTS], expected)


@pytest.mark.parametrize("robot", ["fr3", "ur5e", "xarm7", "so101"])
def test_a_target_beyond_the_reach_that_moves_sideways_takes_the_tcp_along(robot: str) -> None:
    layer, start, forward = layer_of(robot)
    way_out = start[:2] / np.hypot(*start[:2])
    sideways = np.array([-way_out[1], way_out[0]])
    target = start.copy()
    tcps = []
    for shift in np.linspace(-0.72, 0.72, 60):
        target[:2] = 1.6 * way_out + shift * sideways
        for _ in range(40 if not tcps else 3):
            layer.map_executed(layer.map_action({TQUAT: target}))
        assert layer.info()["ik_status"] != IkStatus.ok.value
        tcps.append(forward())
    tcps = np.array(tcps)
    assert (np.diff(tcps[:, :2] @ sideways) > 0).all(), "it never stands still"
    swept = np.arctan2(tcps[:, :2] @ sideways, tcps[:, :2] @ way_out)
    asked = np.arctan2(0.72, 1.6)
    np.testing.assert_allclose([swept[0], swept[-1]], [-asked, asked], atol=0.05)


def test_the_sign_and_the_length_of_a_quaternion_do_not_matter(layer: CartesianControl, home: np.ndarray) -> None:
    scale = np.array([1, 1, 1, -0.5, -0.5, -0.5, -0.5])
    joints = [layer.map_action({TQUAT: target})[JOINTS] for target in (home, home * scale)]
    np.testing.assert_allclose(*joints, atol=1e-12)


def test_a_quaternion_without_a_direction_is_refused(layer: CartesianControl, home: np.ndarray) -> None:
    home[3:] = 0.01
    with pytest.raises(InvalidAction, match="unit quaternion xyzw"):
        layer.map_action({TQUAT: home})


def test_a_refused_quaternion_moves_nothing() -> None:
    env, untouched = (rcs.make("Free", control="tquat", relative=False) for _ in range(2))
    pose = env.reset(seed=0)[0]["tquat"]
    untouched.reset(seed=0)
    with pytest.raises(InvalidAction):
        env.step({"tquat": np.zeros(7), "gripper": OPEN})
    pose[2] -= 0.05
    after = [each.step({"tquat": pose, "gripper": OPEN})[0]["joints"] for each in (env, untouched)]
    np.testing.assert_array_equal(*after)


def test_roll_pitch_yaw_is_the_same_as_a_quaternion() -> None:
    rng = np.random.default_rng(3)
    one, other = (rcs.make("Free", control=control, relative=False) for control in ("tquat", "xyzrpy"))
    pose = one.reset(seed=0)[0]["tquat"]
    other.reset(seed=0)
    for _ in range(10):
        pose = pose + np.append(rng.uniform(-0.01, 0.01, 3), np.zeros(4))
        a = one.step({"tquat": pose, "gripper": OPEN})[0]
        b = other.step({"xyzrpy": tquat_to_xyzrpy(pose), "gripper": OPEN})[0]
        np.testing.assert_allclose(a["joints"], b["joints"], atol=1e-6)


def test_pose_layers_replace_the_key_of_the_level_below_and_keep_the_others() -> None:
    inner = {JOINTS: joints_space(list(FR3.joint_lower), list(FR3.joint_upper)), "gripper": joints_space([0], [1])}
    cartesian = CartesianControl(kinematics_of(FR3, FRANKA_HAND))
    poses = cartesian.action_spaces(inner)
    assert list(poses) == [TQUAT, "gripper"]
    assert list(XyzrpyControl().action_spaces(poses)) == [XYZRPY, "gripper"]
    assert "IkStatus in info" in str(cartesian)


def test_copies_are_solved_each_on_its_own(home: np.ndarray) -> None:
    targets = np.tile(home, (3, 1))
    targets[:, 2] += [0.05, 5.0, -0.05]
    targets[1, 2] = 1.9
    batch = CartesianControl(kinematics_of(FR3, FRANKA_HAND))
    batch.reset({JOINTS: np.tile(HOME, (3, 1))})
    joints = batch.map_action({TQUAT: targets})[JOINTS]
    executed = batch.map_executed({JOINTS: joints})
    for copy, target in enumerate(targets):
        single = CartesianControl(kinematics_of(FR3, FRANKA_HAND))
        single.reset({JOINTS: HOME})
        alone = single.map_action({TQUAT: target})[JOINTS]
        np.testing.assert_array_equal(alone, joints[copy])
        np.testing.assert_array_equal(single.map_executed({JOINTS: alone})[TQUAT], executed[TQUAT][copy])
        assert single.info()["ik_status"] == batch.info()["ik_status"][copy]


def test_copies_are_solved_to_the_same_bits_by_any_number_of_threads() -> None:
    kinematics = kinematics_of(FR3, FRANKA_HAND)
    copies = 2 * ROWS_PER_THREAD + 5
    starts = HOME + np.random.default_rng(0).uniform(-0.3, 0.3, (copies, 7))
    targets = kinematics.forward_batch(starts + np.random.default_rng(1).uniform(-0.05, 0.05, (copies, 7)))
    targets[::7, 2] += 2.0  # out of reach
    solved = []
    for threads in (1, 2, 64):
        layer = CartesianControl(kinematics, preferred=HOME, threads=threads)
        layer.reset({JOINTS: starts})
        solved.append(layer.map_action({TQUAT: targets})[JOINTS])
    np.testing.assert_array_equal(solved[0], solved[1])
    np.testing.assert_array_equal(solved[0], solved[2])


@pytest.mark.parametrize("call", ["map_action", "map_executed"])
def test_without_a_reset_there_is_no_start(call: str) -> None:
    layer: Any = CartesianControl(kinematics_of(FR3, FRANKA_HAND))
    with pytest.raises(RuntimeError, match="before"):
        getattr(layer, call)({TQUAT: np.zeros(7), JOINTS: HOME})
