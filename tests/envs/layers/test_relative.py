from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rcs
from rcs.envs.layers import LimitStep, Relative
from rcs.envs.layers.relative import shift
from rcs.envs.ports.port import Port
from rcs.envs.spaces import JOINTS, TQUAT, joints_space, tquat_space
from rcs.envs.step.chain import Chain
from rcs.envs.step.stack import Stack
from rcs.errors import InvalidAction
from rcs.kinematics import IkStatus, kinematics_of
from rcs.spatial import Pose, compose, distance


def play(env: Any, actions: Any, *, key: str, seed: int = 0) -> list[dict[str, Any]]:
    seen = [env.reset(seed=seed)[0]]
    for value in actions:
        seen.append(env.step({key: value, "gripper": np.ones(1, np.float32)})[0])
    return seen


def test_relative_joints_are_absolute_joints_added_up() -> None:
    rng = np.random.default_rng(0)
    differences = rng.uniform(-0.08, 0.08, (20, 7))
    relative, absolute = rcs.make("Free"), rcs.make("Free", relative=False)
    first = relative.reset(seed=0)[0]["joints"]
    targets, target = [], first
    for difference in differences:
        target = target + difference
        targets.append(target)
    for one, other in zip(
        play(relative, differences, key="joints"), play(absolute, targets, key="joints"), strict=True
    ):
        for name in one:
            np.testing.assert_array_equal(one[name], other[name])


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("control", ["tquat", "xyzrpy"])
def test_a_relative_pose_moves_the_tcp_along_the_axes_of_the_base(control: str, axis: int) -> None:
    step = -0.004
    env = rcs.make("Free", control=control)
    move, stay = np.zeros((2, 7 if control == "tquat" else 6))
    move[axis] = step
    if control == "tquat":
        move[6] = stay[6] = 1.0
    seen = play(env, [move] * 30 + [stay] * 10, key=control)
    first, last = seen[0]["tquat"], seen[-1]["tquat"]
    expected = first.copy()
    expected[axis] += 30 * step
    assert distance(last, expected)[0] < 1e-3
    assert distance(last, expected)[1] < 5e-3


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_relative_rotation_turns_the_tcp_about_the_axes_of_the_base(axis: int) -> None:
    turn, stay = np.zeros((2, 6))
    turn[3 + axis] = 0.02
    env = rcs.make("Free", control="xyzrpy")
    seen = play(env, [turn] * 15 + [stay] * 10, key="xyzrpy")
    first, last = Pose(*np.split(seen[0]["tquat"], [3])), Pose(*np.split(seen[-1]["tquat"], [3]))
    expected = Pose.from_rpy([0, 0, 0], list(15 * turn[3:])) * Pose([0, 0, 0], first.quaternion)
    assert Pose([0, 0, 0], last.quaternion).angle_to(expected) < 5e-3
    assert last.distance_to(first) < 2e-3


def test_differences_to_an_origin_do_not_add_up() -> None:
    env = rcs.make("Free", relative="origin")
    seen = play(env, [np.full(7, 0.05)] * 20, key="joints")
    np.testing.assert_allclose(seen[-1]["joints"], seen[0]["joints"] + 0.05, atol=5e-3)


def test_the_origin_can_be_set_to_the_last_target() -> None:
    env = rcs.make("Free", relative="origin")
    first = play(env, [np.full(7, 0.05)] * 10, key="joints")[0]["joints"]
    layer = next(layer for layer in env.stack.layers if isinstance(layer, Relative))
    layer.set_origin()
    for _ in range(10):
        observation, *_ = env.step({"joints": np.full(7, 0.05), "gripper": np.ones(1, np.float32)})
    np.testing.assert_allclose(observation["joints"], first + 0.10, atol=5e-3)


class Blocked(Port):
    """An arm that something holds fast."""

    def __init__(self, dof: int) -> None:
        self.action_spaces = {JOINTS: joints_space([-3.0] * dof, [3.0] * dof)}
        self.observation_spaces = {JOINTS: joints_space([-3.0] * dof, [3.0] * dof)}
        self.target = np.zeros(dof)

    def command(self, action: Any) -> None:
        self.target = action[JOINTS]

    def observe(self) -> dict[str, Any]:
        return {JOINTS: np.zeros_like(self.target)}


def test_the_target_of_a_blocked_arm_does_not_wind_up() -> None:
    port = Blocked(2)
    layers = [LimitStep(np.full(2, 0.1), 0.6), Relative(JOINTS, frequency=30.0, joint_speed=3.0)]
    stack = Stack(Chain([port], layers))
    stack.reset(stack.measure(), ...)
    for _ in range(100):
        stack.send(stack.map({JOINTS: np.full(2, 0.1)}))
        stack.lift(stack.measure())
    np.testing.assert_allclose(port.target, 0.6)
    stack.send(stack.map({JOINTS: np.full(2, -0.1)}))
    np.testing.assert_allclose(port.target, 0.5)


def test_relative_joints_stop_at_the_limits() -> None:
    env = rcs.make("Free")
    env.reset(seed=0)
    for _ in range(60):
        observation, *_ = env.step({"joints": np.full(7, 0.08), "gripper": np.ones(1, np.float32)})
    box = env.stack.executed_spaces["joints"]
    assert box.contains(env.stack.executed["joints"])
    assert (observation["joints"] <= box.high + 0.02).all()


def test_a_rotation_is_cut_to_its_largest_angle() -> None:
    start = np.array([0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0])
    half_turn = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    moved = shift(start, half_turn, 0.2)
    np.testing.assert_allclose(moved[:3], start[:3])
    assert distance(start, moved)[1] == pytest.approx(0.2)
    assert distance(start, shift(start, half_turn))[1] == pytest.approx(np.pi)


def test_shift_turns_from_the_left_and_moves_along_the_parent() -> None:
    rng = np.random.default_rng(1)
    poses = rng.normal(size=(2, 10, 7))
    poses[..., 3:] /= np.linalg.norm(poses[..., 3:], axis=-1, keepdims=True)
    start, step = poses
    moved = shift(start, step)
    np.testing.assert_allclose(moved[:, :3], start[:, :3] + step[:, :3])
    turn, turned = step.copy(), start.copy()
    turn[:, :3] = turned[:, :3] = 0.0
    expected = compose(turn, turned)
    np.testing.assert_allclose(np.abs((moved[:, 3:] * expected[:, 3:]).sum(-1)), 1.0)


@pytest.mark.parametrize(("control", "size"), [("joints", 2), ("tquat", 7), ("xyzrpy", 6)])
@pytest.mark.parametrize("to", ["last_step", "origin"])
def test_the_space_of_differences_is_under_the_key_of_the_control_and_symmetric_but_for_the_last_of_a_quaternion(
    control: Any, size: int, to: Any
) -> None:
    key = JOINTS if control == "joints" else TQUAT
    inner = {key: joints_space([-1.0, -2.0], [1.0, 3.0]) if key == JOINTS else tquat_space(), "gripper": tquat_space()}
    boxes = Relative(control, frequency=30.0, to=to, joint_speed=3.0).action_spaces(inner)
    assert list(boxes) == [control, "gripper"]
    assert boxes[control].shape == (size,)
    np.testing.assert_array_equal(boxes[control].low[:6], -boxes[control].high[:6])
    if control == "joints":
        np.testing.assert_allclose(boxes[control].high, [0.1, 0.1] if to == "last_step" else [2.0, 5.0])


def test_without_a_reset_there_is_no_reference() -> None:
    layer = Relative(JOINTS, frequency=30.0)
    for call in (lambda: layer.map_action({JOINTS: np.zeros(2)}), layer.set_origin):
        with pytest.raises(RuntimeError, match="before reset"):
            call()


@pytest.mark.parametrize("control", ["joints", "tquat", "xyzrpy"])
def test_the_same_share_of_the_bounds_moves_equally_fast_at_every_rate(control: str) -> None:
    # A third of the bounds for a fifth of a second, in few steps or in many.
    targets = []
    for frequency in (10.0, 30.0, 100.0):
        env = rcs.make("Free", control=control, frequency=frequency)
        env.reset(seed=0)
        box = env.action_space[control]
        action = 0.3 * box.high if control != "tquat" else np.append(0.3 * box.high[:6], 1.0)
        for _ in range(round(0.2 * frequency)):
            *_, info = env.step({control: action, "gripper": np.ones(1, np.float32)})
        targets.append(env.stack.target[JOINTS if control == "joints" else TQUAT])
    if control == "joints":
        np.testing.assert_allclose(targets, [targets[0]] * 3, atol=1e-9)
    else:
        # A few small turns about three axes are not quite one large one.
        assert (distance(np.array(targets), targets[0]) < (1e-3, 1e-2)).all()


def test_every_sample_of_relative_quaternions_is_accepted_and_zeros_are_no_member() -> None:
    env = rcs.make("Free", control="tquat")
    env.reset(seed=0)
    env.action_space.seed(0)
    for _ in range(50):
        action = env.action_space.sample()
        assert env.action_space.contains(action)
        env.step(action)
    zeros = {TQUAT: np.zeros(7), "gripper": np.ones(1, np.float32)}
    assert not env.action_space.contains(zeros)
    with pytest.raises(InvalidAction, match="'tquat'"):
        env.step(zeros)


@pytest.mark.parametrize("frequency", [0.1, 1.0, 30.0, 500.0])
def test_no_member_of_a_space_of_small_rotations_is_without_direction(frequency: float) -> None:
    box = Relative(TQUAT, frequency=frequency).action_spaces({TQUAT: tquat_space()})[TQUAT]
    assert box.low[6] > 0.3
    assert box.contains(np.array([0, 0, 0, 0, 0, 0, 1.0]))
    half = min(2.0 / frequency, 2.5) / 2
    assert box.contains(np.array([0, 0, 0, 0, np.sin(half), 0, np.cos(half)]))


def test_a_difference_to_the_origin_without_a_direction_is_refused() -> None:
    env = rcs.make("Free", control="tquat", relative="origin")
    env.reset(seed=0)
    with pytest.raises(InvalidAction, match="no rotation"):
        env.step({TQUAT: np.zeros(7), "gripper": np.ones(1, np.float32)})


@pytest.mark.parametrize("robot", ["fr3", "ur5e", "xarm7", "so101"])
def test_random_relative_poses_that_are_cut_keep_the_direction_of_the_tcp(robot: str) -> None:
    env = rcs.make("Free", robot=robot, control="xyzrpy", max_episode_steps=None)
    arm = env.robots[robot]
    kinematics = kinematics_of(arm.arm, arm.end_effector)
    env.action_space.seed(0)
    angles = []
    for k in range(400):
        if k % 100 == 0:
            joints = env.reset(seed=k)[0][JOINTS]
        before = kinematics.forward(joints).tquat
        action = env.action_space.sample()
        *_, info = env.step(action)
        joints = env.stack.executed[JOINTS]
        way = kinematics.forward(joints).tquat[:3] - before[:3]
        asked = action["xyzrpy"][:3]
        if info["ik_status"] != IkStatus.ok.value or info["is_limited"]:
            angles.append(np.arccos(np.clip(way @ asked / np.linalg.norm(way) / np.linalg.norm(asked), -1, 1)))
    assert angles
    assert np.degrees(np.quantile(angles, 0.9)) <= 15.0
    assert len(angles) < 200, "the bounds are what the arm can do"
