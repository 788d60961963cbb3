from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rcs_data import Dataset

import rcs
from rcs.envs.layers import TwistControl
from rcs.envs.observers.record import record
from rcs.envs.spaces import JOINTS, TQUAT, TWIST
from rcs.errors import InvalidAction, InvalidSetup
from rcs.kinematics import IkStatus, kinematics_of
from rcs.rollout.replay import replay
from rcs.spatial import Pose

ROBOTS = ["fr3", "ur5e", "xarm7", "so101"]
OPEN = np.ones(1, np.float32)


def act(*twist: float) -> dict[str, Any]:
    return {TWIST: np.array(twist), "gripper": OPEN}


def layer_of(robot: str) -> tuple[TwistControl, Any]:
    env = rcs.make("Free", robot=robot, control="twist")
    placement = env.robots[robot]
    layer = next(layer for layer in env.stack.layers if isinstance(layer, TwistControl))
    layer.reset({JOINTS: np.array(placement.arm.home)})
    return layer, placement


def turned(pose: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    return (Pose.from_rotvec([0.0, 0.0, 0.0], rotation) * Pose([0.0, 0.0, 0.0], pose[3:])).quaternion


@pytest.mark.parametrize("robot", ROBOTS)
def test_at_zero_the_target_stays_for_ever(robot: str) -> None:
    layer, placement = layer_of(robot)
    for twist in ((0.03, -0.02, 0.05, 0.0, 0.0, 0.1), (0.0,) * 6):
        for _ in range(20):
            executed = layer.map_executed(layer.map_action(act(*twist)))
    before = layer.map_action(act(*[0.0] * 6))[JOINTS]
    for _ in range(100):
        layer.map_executed(layer.map_action(act(*[0.0] * 6)))
    np.testing.assert_array_equal(layer.map_action(act(*[0.0] * 6))[JOINTS], before)
    assert layer.info()["ik_status"] == IkStatus.ok.value
    np.testing.assert_allclose(
        executed[TQUAT], kinematics_of(placement.arm, placement.end_effector).forward(before).tquat, atol=1e-12
    )


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_simulated_arm_at_zero_does_not_drift(robot: str) -> None:
    with rcs.make("Free", robot=robot, control="twist") as env:
        env.reset(seed=1)
        for _ in range(30):
            env.step(act(0.05, 0.05, -0.02, 0.0, 0.0, 0.0))
        for _ in range(140):  # until the servos have come to rest
            observation = env.step(act(*[0.0] * 6))[0]
        for _ in range(100):
            later = env.step(act(*[0.0] * 6))[0]
        assert np.abs(later[JOINTS] - observation[JOINTS]).max() < 1e-5


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("frequency", [20, 90])
def test_the_tcp_moves_at_the_speed_that_was_asked_for(robot: str, frequency: float) -> None:
    share = 0.25 if robot != "so101" else 0.1
    asked = np.array([0.1, 0.3, -0.15, 0.0, 0.0, 0.4]) * share
    if robot == "so101":
        asked[3:] = 0.0
    with rcs.make("Free", robot=robot, control="twist", frequency=frequency, max_episode_steps=None) as env:
        env.reset(seed=1)
        for _ in range(int(0.5 * frequency)):  # until it has sped up
            before = env.step(act(*asked))[0]
        steps = int(1.0 * frequency)
        for _ in range(steps):
            observation, *_, info = env.step(act(*asked))
            assert info["ik_status"] == IkStatus.ok.value
            assert not info["is_limited"]
    duration = steps / frequency
    speed = (observation[TQUAT][:3] - before[TQUAT][:3]) / duration
    # What gravity and play of the servos leave is the same before and after; the SO101's are those of a toy.
    np.testing.assert_allclose(speed, asked[:3], atol=1e-3)
    if robot != "so101":
        expected = Pose([0.0, 0.0, 0.0], turned(before[TQUAT], asked[3:] * duration))
        assert Pose([0.0, 0.0, 0.0], observation[TQUAT][3:]).angle_to(expected) < 5e-3


def test_a_twist_that_is_too_fast_goes_slower_the_same_way() -> None:
    layer, placement = layer_of("ur5e")
    kinematics = kinematics_of(placement.arm, placement.end_effector)
    start = kinematics.forward(np.array(placement.arm.home)).tquat
    high = layer.action_spaces({JOINTS: rcs.make("Free", robot="ur5e").stack.chains[""].executed_spaces[JOINTS]})
    fast = high[TWIST].high * np.array([1.0, 1.0, -1.0, 1.0, 1.0, 1.0])
    executed = layer.map_executed(layer.map_action({TWIST: fast}))
    assert layer.info()["ik_status"] == IkStatus.clamped.value
    way = executed[TQUAT][:3] - start[:3]
    np.testing.assert_allclose(way / np.linalg.norm(way), fast[:3] / np.linalg.norm(fast[:3]), atol=1e-3)
    assert np.linalg.norm(way) < np.linalg.norm(fast[:3]) / 30


def test_a_refused_twist_leaves_no_trace() -> None:
    env, untouched = (rcs.make("Free", control="twist") for _ in range(2))
    for one in (env, untouched):
        one.reset(seed=0)
    for bad in (np.full(6, np.nan), np.full(6, 9.0), np.zeros(5)):
        with pytest.raises(InvalidAction, match="twist"):
            env.step({TWIST: bad, "gripper": OPEN})
    good = act(0.1, 0.0, 0.0, 0.0, 0.0, 0.0)
    np.testing.assert_array_equal(env.step(good)[0][JOINTS], untouched.step(good)[0][JOINTS])


def test_what_changes_poses_refuses_twists() -> None:
    with pytest.raises(InvalidSetup, match="KeepTilt is on top of twist, gripper; it needs control='xyzrpy'"):
        rcs.make("Free", control="twist", layers=("KeepTilt",))


def test_the_target_is_observed_as_a_pose() -> None:
    with rcs.make("Free", control="twist", layers=("ObserveTarget",)) as env:
        start = env.reset(seed=0)[0]
        observation, *_, info = env.step(act(0.12, 0.0, 0.0, 0.0, 0.0, 0.0))
        np.testing.assert_array_equal(observation["target"][TQUAT], info["target"][TQUAT])
        way = observation["target"][TQUAT][:3] - start[TQUAT][:3]
        np.testing.assert_allclose(way, [0.12 / 30, 0.0, 0.0], atol=1e-9)


def test_an_episode_is_recorded_and_replayed_bit_for_bit(tmp_path: Any) -> None:
    with rcs.make("Free", robot="ur5e", control="twist") as env, record(env, tmp_path / "data") as takes:
        for seed in (1, 2):
            takes.start(at_reset=True)
            env.reset(seed=seed)
            for i in range(15):
                env.step(act(0.1 * np.sin(i), 0.05, -0.05, 0.1, 0.0, 0.2))
            takes.finish(success=True)
    episode = next(iter(Dataset.open(tmp_path / "data")))
    assert episode.column("action/twist").shape == (16, 6)
    assert all(result.is_equal for result in replay(tmp_path / "data"))
